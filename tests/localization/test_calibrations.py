"""Self-calibration from a log: recorded with a lens that is off, localized with and without estimating that."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from coop_envs import exploration_v0
from coop_envs.localization.command import main
from coop_envs.localization.logs.read_log import write_log
from coop_envs.sensing.camera import CameraModel, camera_model
from coop_envs.simulation.calibration import CalibrationError, true_camera
from examples.record_log import Recorder, mission
from tests.localization.generated_team import generated_log

FOCAL_SHARE = 0.02


@wp.kernel
def true_focal(
    believed: wp.array[CameraModel], error: CalibrationError, key: wp.array[wp.uint64], share: wp.array[float]
):
    share[0] = true_camera(believed[0], error, key[0], 0).focal[0] / believed[0].focal[0] - 1.0


def recorded(folder: Path, seed: int, increments: int) -> float:
    """Write a log; by which share the observer's true focal length is more than the believed one."""
    changes: dict[str, Any] = {"rates.ticks_per_decision": 1, "sensing.calibration.focal_share": FOCAL_SHARE}
    env = exploration_v0.parallel_env(scenario="u_turn", **changes)
    env.reset(seed=seed)
    recorder = Recorder(env)
    for robot, seconds in mission(increments):
        recorder.drive(robot, seconds)
    write_log(folder, recorder.log())
    error, share = CalibrationError(), wp.zeros(1, dtype=float)
    error.focal_share = FOCAL_SHARE
    camera = wp.array([camera_model(env.scenario.team.members[0].camera)], dtype=CameraModel)
    wp.launch(true_focal, 1, inputs=[camera, error, env.batch.state.key, share])
    return float(share.numpy()[0])


def localized(log: Path, out: Path, settings: str = "") -> dict[str, Any]:
    """What results.json holds."""
    out.mkdir()
    (out / "settings.yaml").write_text(settings or "{}\n", encoding="utf-8")
    assert main([str(log), "--out", str(out), "--settings", str(out / "settings.yaml")]) == 0
    return json.loads((out / "results.json").read_text(encoding="utf-8"))


def check_gain(folder: Path, seed: int, increments: int, least: float) -> float:
    """Drift falls by ``least`` and covariances become right; how many standard deviations the focal length is off."""
    share = recorded(folder / "log", seed, increments)
    plain = localized(folder / "log", folder / "plain")
    ours = localized(folder / "log", folder / "ours", f"estimation: {{focal_sigma: {FOCAL_SHARE}}}\n")
    assert plain["calibration"] == {} and set(ours["calibration"]) == {"observer_0"}
    drifts = [np.mean([one["position_drift_m"] for one in found["robots"].values()]) for found in (plain, ours)]
    assert drifts[0] > least * drifts[1]
    nees = [max(one["nees_mean"] for one in found["robots"].values()) for found in (plain, ours)]
    assert nees[0] > 5.0 and nees[1] < 2.0
    (kind, focal), *others = ours["calibration"]["observer_0"].items()
    assert kind == "focal" and not others and focal["sigma"] < 0.4 * FOCAL_SHARE
    return (focal["value"] - share) / focal["sigma"]


def test_a_focal_length_that_is_off_is_found(tmp_path):
    assert abs(check_gain(tmp_path, seed=0, increments=1, least=2.0)) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_longer_way_tells_more(tmp_path, seed):
    assert abs(check_gain(tmp_path, seed, increments=3, least=4.0)) < 3.0


def test_every_state_stands_under_its_name(tmp_path):
    write_log(tmp_path / "log", generated_log(increments=1, imu_hz=30.0))
    names = ("focal_sigma", "centre_sigma_px", "lever_sigma_m", "lever_sigma_rad", "hat_sigma_m")
    prior = {name: 0.001 * (k + 1) for k, name in enumerate(names)}
    text = "clocks: stamps\nestimation: {" + ", ".join(f"{name}: {sigma}" for name, sigma in prior.items()) + "}\n"
    found = localized(tmp_path / "log", tmp_path / "out", text)["calibration"]
    assert set(found) == {"observer_0", "picket_0", "picket_1"}
    told = dict(zip(names, ("focal", "centre_px", "place_m", "turn_rad", "leds_m"), strict=True))
    for name, shape in {"focal": (), "centre_px": (2,), "place_m": (3,), "turn_rad": (3,)}.items():
        assert np.shape(found["observer_0"][name]["value"]) == shape
    for robot in ("picket_0", "picket_1"):
        assert np.shape(found[robot]["leds_m"]["value"]) == (5, 3)
    for name, kind in told.items():
        for robot in found.values():
            if kind in robot:  # what poses told narrows what was known before, and never much beyond it
                sigma = np.array(robot[kind]["sigma"])
                assert np.all((sigma > 0.0) & (sigma <= prior[name] * (1 + 1e-9)))
                assert np.all(np.abs(robot[kind]["value"]) < 4.0 * prior[name])
