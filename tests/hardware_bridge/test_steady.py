"""What is done before a mission, so that nothing holds it up later."""

from __future__ import annotations

import gc
import re
from pathlib import Path

from hardware_bridge.steady import PLANNING, frozen_heap

ROOT = Path(__file__).parents[2]


def test_whatever_policies_import_late_is_loaded_beforehand():
    late = re.compile(r"^ +(?:from|import) ((?:scipy|skimage|cv2)[\w.]*)(?: import (\w+))?", re.MULTILINE)
    sources = [*(ROOT / "baselines").glob("*.py"), ROOT / "coop_envs" / "mapping" / "planning.py"]
    found = {match for source in sources for match in late.findall(source.read_text())}
    assert found
    assert [(module, name) for module, name in found if not {module, f"{module}.{name}"} & {*PLANNING}] == []


def test_the_heap_is_frozen_only_in_the_meantime():
    before = gc.get_freeze_count()
    with frozen_heap():
        assert gc.get_freeze_count() > before
    assert gc.get_freeze_count() == 0
