"""The rule that CI skips nothing, on small test files of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SKIPS_A_TEST = "import pytest\ndef test_one(): pytest.skip('no robot here')\n"
SKIPS_ITSELF = "import pytest\npytest.skip('no robot here', allow_module_level=True)\n"
EXPECTED_TO_FAIL = "import pytest\n@pytest.mark.xfail\ndef test_one(): assert False\n"


@pytest.mark.parametrize(
    ("text", "ci", "passes"),
    [
        (SKIPS_A_TEST, "true", False),
        (SKIPS_ITSELF, "true", False),
        (EXPECTED_TO_FAIL, "true", True),
        (SKIPS_A_TEST, "", True),
    ],
)
def test_skips_fail_in_ci_alone(text, ci, passes, tmp_path):
    (tmp_path / "test_file.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.conftest", "--rootdir", str(tmp_path), str(tmp_path)]
    run = subprocess.run(command, cwd=ROOT, env=os.environ | {"CI": ci}, capture_output=True, text=True, check=False)
    assert (run.returncode == 0) == passes, run.stdout
    assert passes or "no robot here" in run.stdout
