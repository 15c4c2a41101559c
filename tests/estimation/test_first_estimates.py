"""What nobody can observe stays unobserved: a team's own sightings tell nothing of its place and heading as a whole."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from coop_envs.estimation.belief import Belief, MemberModel
from coop_envs.estimation.calibration import Optics
from coop_envs.estimation.kalman import correct_six
from coop_envs.estimation.propagation import follow_shift, linearise
from coop_envs.estimation.rows import Rows
from coop_envs.estimation.sightings import judge
from coop_envs.sensing.measurements import Measurements
from tests.estimation.bench import Bench, camera_view

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.kernel
def run_fusion(
    belief: Belief, measured: Measurements, members: wp.array[MemberModel], optics: Optics, rows: Rows, carried: int
):
    linearise(belief, 0)
    for j in range(1, 3):
        verdict = judge(belief, measured, members, optics, rows, 0, 0, j, True)
        correct_six(belief, rows, 0, verdict.white)
        if carried == 0:
            linearise(belief, 0)
    if carried == 1:
        follow_shift(belief, rows, 0)


def gauge(bench: Bench) -> np.ndarray:
    """(15 n, 4): a shift of the whole team along x, y, z, and a turn about gravity through the origin."""
    columns = np.zeros((bench.n, 5, 3, 4))
    columns[:, 1, :, :3] = np.eye(3)
    up = np.array([0.0, 0.0, 1.0])
    columns[:, 0, :, 3] = up
    columns[:, 1, :, 3] = np.cross(up, bench.get("position"))
    columns[:, 2, :, 3] = np.cross(up, bench.get("velocity"))
    return columns.reshape(-1, 4)


def certainty(bench: Bench) -> np.ndarray:
    """(4, 4) information about the gauge, all else known."""
    N = gauge(bench)
    return N.T @ np.linalg.solve(bench.P, N)


def look_from_elsewhere(bench: Bench, rng: np.random.Generator) -> None:
    """Sightings by robot 0 of a team that stands some centimetres from where it is believed to."""
    truth = bench.state()
    truth["position"] = truth["position"] + rng.normal(size=(bench.n, 3)) * 0.03
    turns = Rotation.from_rotvec(rng.normal(size=(bench.n, 3)) * 0.02).as_matrix()
    truth["rotation"] = turns @ truth["rotation"]
    for j in (1, 2):
        R, p = camera_view(truth, 0, j)
        bench.sighting(0, j, R, p, np.diag([1e-5] * 3 + [1e-6] * 3))


@pytest.mark.parametrize("seed", range(3))
def test_a_team_learns_nothing_of_its_own_place_and_heading(seed):
    bench, rng = Bench(seed=seed), np.random.default_rng(seed)
    bench.P = bench.P * 4.0
    before = certainty(bench)
    for _ in range(10):
        look_from_elsewhere(bench, rng)
        bench.run(run_fusion, bench.belief, bench.measured, bench.members, bench.optics, bench.rows, 1)
    np.testing.assert_allclose(certainty(bench), before, rtol=1e-6, atol=1e-6 * before.max())


def test_derivatives_taken_anew_at_every_update_feign_it():
    bench, rng = Bench(seed=0), np.random.default_rng(0)
    bench.P = bench.P * 4.0
    before = certainty(bench)[3, 3]
    for _ in range(10):
        look_from_elsewhere(bench, rng)
        bench.run(run_fusion, bench.belief, bench.measured, bench.members, bench.optics, bench.rows, 0)
    assert certainty(bench)[3, 3] > 1.5 * before
