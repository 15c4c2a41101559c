"""Replays a log in a process that cannot import the simulator: ``python -m ... LOG SETTINGS OUT``."""

from __future__ import annotations

import importlib.abc
import json
import pickle
import sys
from pathlib import Path

FORBIDDEN = tuple(
    f"coop_envs.{name}" for name in ("simulation", "worlds", "world_pool", "batch", "scoring", "scenario")
)


class NoSimulator(importlib.abc.MetaPathFinder):
    """Refuses every module that knows the truth."""

    def find_spec(self, fullname, path=None, target=None):
        del path, target
        if fullname.startswith(FORBIDDEN):
            raise ImportError(f"{fullname} is not on a robot's host")


def main(log: str, settings: str, out: str) -> None:
    sys.meta_path.insert(0, NoSimulator())
    from tests.hardware_bridge.episode import replayed

    known, plan = pickle.loads(Path(settings).read_bytes())
    Path(out).write_text(json.dumps(replayed(Path(log), known, plan)))
    assert not any(name.startswith(FORBIDDEN) for name in sys.modules)


if __name__ == "__main__":
    main(*sys.argv[1:])
