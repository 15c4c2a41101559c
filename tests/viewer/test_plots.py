import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from coop_envs.recording import Frame, WorldPicture
from coop_envs.viewer import plots
from coop_envs.viewer.curves import band, bands
from coop_envs.viewer.metrics import known_metrics

pytestmark = pytest.mark.render


def test_a_band_is_median_and_quartiles_and_ended_curves_keep_their_last_value() -> None:
    curves = [([0.0, 10.0], [0.0, 10.0 * slope]) for slope in (1, 2, 3, 4)] + [([0.0, 5.0], [0.0, 0.0])]
    result = band(curves, np.array([0.0, 5.0, 10.0, 20.0]))
    assert result.median.tolist() == [0, 10, 20, 20]
    assert result.low.tolist() == [0, 5, 10, 10]
    assert result.high.tolist() == [0, 15, 30, 30]


def test_bands_skip_episodes_without_series_and_share_their_axis() -> None:
    def episode(end: float) -> dict:
        return {"series": {"time_s": [0.0, end], "coverage": [0.0, 1.0]}}

    result = bands(
        {"a": [episode(10), {}], "b": [episode(20)], "c": [{"series": {}}, {"series": None}]}, "time_s", count=5
    )
    assert list(result) == ["a", "b"]
    assert result["a"].x.tolist() == result["b"].x.tolist() == [0, 5, 10, 15, 20]
    assert result["a"].median.tolist() == [0, 0.5, 1, 1, 1]


def test_lines_show_the_medians() -> None:
    result = bands({"a": [{"series": {"time_s": [0.0, 2.0], "coverage": [0.0, 0.5]}}]}, "time_s")
    axes = plots.draw_bands(result, "time (s)", "coverage (%)", scale=100.0).axes[0]
    assert axes.lines[0].get_label() == "a"
    assert np.asarray(axes.lines[0].get_ydata())[-1] == pytest.approx(50.0)


def test_bars_show_estimates_and_intervals_in_their_units() -> None:
    coverage = next(metric for metric in known_metrics() if metric.name == "coverage")
    aggregates = {"a": {"coverage": {"iqm": 0.5, "low": 0.4, "high": 0.7, "n": 9}}}
    axes: Any = plots.draw_intervals(aggregates, [coverage]).axes[0]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([50.0])
    assert axes.collections[0].get_segments()[0][:, 0] == pytest.approx((40.0, 70.0))


def test_a_trajectory_is_drawn_in_metres(world: WorldPicture, frames: list[Frame]) -> None:
    figure = plots.draw_trajectories(world, frames)
    axes = figure.axes[0]
    assert (axes.get_xlim(), axes.get_ylim()) == ((-0.5, 0.8), (-0.05, 0.65))
    shown = np.asarray(axes.lines[0].get_xydata())
    assert shown == pytest.approx(np.array([frame.true_xy_yaw[0, :2] for frame in frames]))
    assert plots.picture(figure).shape[2] == 3
    assert plots.png(figure).startswith(b"\x89PNG")


def test_importing_the_viewer_loads_no_matplotlib() -> None:
    code = "import sys, coop_envs.viewer.report, coop_envs.viewer.topview; print('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
