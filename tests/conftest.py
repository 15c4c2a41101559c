"""What all tests share: in CI nothing may be skipped, and elsewhere what is left out is named."""

from __future__ import annotations

import functools
import os

import pytest


def _in_ci() -> bool:
    return os.environ.get("CI") == "true"


@functools.cache
def _ros_missing() -> str | None:
    from hardware_bridge.ros1 import missing

    return missing()


def pytest_collection_modifyitems(config, items):
    """Where there is no ROS, leave out what needs it."""
    needs_ros = [item for item in items if item.get_closest_marker("ros")]
    if needs_ros and _ros_missing() and not _in_ci():
        config.hook.pytest_deselected(items=needs_ros)
        items[:] = [item for item in items if item not in needs_ros]


def pytest_runtest_setup(item):
    """In CI a machine without ROS fails what needs it."""
    if item.get_closest_marker("ros") and _ros_missing():
        pytest.fail(f"needs ROS, which CI=true demands ({_ros_missing()})", pytrace=False)


def pytest_terminal_summary(terminalreporter):
    """Name the suite that was left out."""
    if not _in_ci() and _ros_missing():
        terminalreporter.write_line(f"LEFT OUT: the tests marked ros ({_ros_missing()})", yellow=True)


def _refuse_skip(report: pytest.TestReport | pytest.CollectReport) -> None:
    if report.skipped and _in_ci() and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.outcome = "failed"
        report.longrepr = f"{report.nodeid}: skipped, which CI=true forbids ({reason})"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Turn a skipped test into a failed one where ``CI=true``: what cannot run there is tested nowhere."""
    report = yield
    _refuse_skip(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """The same for files that skip themselves as a whole."""
    report = yield
    _refuse_skip(report)
    return report
