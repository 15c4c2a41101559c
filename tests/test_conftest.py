"""The rules that CI skips nothing and that what is left out is named, on small test files of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SKIPS_A_TEST = "import pytest\ndef test_one(): pytest.skip('no robot here')\n"
SKIPS_ITSELF = "import pytest\npytest.skip('no robot here', allow_module_level=True)\n"
NEEDS_ROS = "import pytest\n@pytest.mark.ros\ndef test_one(): pass\ndef test_two(): pass\n"
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
    run = nested(tmp_path, text, CI=ci)
    assert (run.returncode == 0) == passes, run.stdout
    assert passes or "no robot here" in run.stdout


def nested(folder, text, **environment):
    """A run of pytest on a file with this text."""
    (folder / "test_file.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.conftest", "--rootdir", str(folder), str(folder)]
    return subprocess.run(command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, check=False)


def test_without_ros_its_tests_are_left_out_by_name(tmp_path):
    """A machine without roscore: nothing is in the path."""
    run = nested(tmp_path, NEEDS_ROS, CI="", PATH="")
    assert run.returncode == 0 and "1 passed, 1 deselected" in run.stdout, run.stdout
    assert "LEFT OUT: the tests marked ros (ro" in run.stdout


def test_without_ros_ci_fails(tmp_path):
    run = nested(tmp_path, NEEDS_ROS, CI="true", PATH="")
    assert run.returncode == 1 and "needs ROS, which CI=true demands" in run.stdout, run.stdout


@pytest.mark.ros
def test_with_ros_nothing_is_left_out(tmp_path):
    run = nested(tmp_path, NEEDS_ROS, CI="")
    assert run.returncode == 0 and "2 passed" in run.stdout and "LEFT OUT" not in run.stdout, run.stdout
