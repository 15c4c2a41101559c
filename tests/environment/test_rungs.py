"""Rungs `poses` and `features` on the same truth: alike in what they detect, how well they localise, how they fail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.metrics import observer_drift
from tests.environment.policies import hold_all

TEAMS, DECISIONS, PHASE = 120, 180, 15
WRONG = 40.0
"""Squared normalised error of a pose that has nothing to do with its covariance: 5e-7 of good ones exceed it."""


@dataclass(frozen=True)
class Outcome:
    """What one rung made of every team: errors of the observer, sightings, wrong ones among them, and the truth."""

    drift_m: np.ndarray
    heading_rad: np.ndarray
    sightings: np.ndarray
    wrong: np.ndarray
    truth: np.ndarray


def inchworm_plan(robots: int, seed: int) -> np.ndarray:
    """Actions (decisions, teams, robots, 8): pickets wander while the observer rests, then the other way round."""
    rng = np.random.default_rng(seed)
    plan = np.empty((DECISIONS, TEAMS, robots, 8), dtype=np.float32)
    plan[:] = hold_all(robots)
    plan[..., 7] = 1.0
    for begin in range(0, DECISIONS, PHASE):
        movers = slice(1, None) if (begin // PHASE) % 2 == 0 else slice(0, 1)
        part = plan[begin : begin + PHASE - 4, :, movers]
        count = part.shape[2]
        part[..., 0] = -1.0
        part[..., 1] = rng.uniform(-0.2, 0.5, (TEAMS, count))
        part[..., 2] = rng.uniform(-0.35, 0.35, (TEAMS, count))
    return plan


def wrong_sightings(batch) -> np.ndarray:
    """(B,) sightings of this decision that are wrong, by truth."""
    state, out = batch.state, batch.measurements
    rotation, position = state.rotation.numpy().astype(float), state.position.numpy().astype(float)
    wrong = np.zeros(len(position), dtype=int)
    cameras = batch.physics.cameras.numpy()
    for i in range(position.shape[1]):
        b, j = np.nonzero(out.seen.numpy()[:, i])
        R_wc = rotation[b, i] @ cameras["R_body_camera"][i]
        eye = position[b, i] + rotation[b, i] @ cameras["p_body_camera"][i]
        R = np.einsum("nji,njk->nik", R_wc, rotation[b, j])
        p = np.einsum("nji,nj->ni", R_wc, position[b, j] - eye)
        turn = out.R_camera_body.numpy()[b, i, j] @ R.transpose(0, 2, 1)
        theta = 0.5 * np.stack([turn[:, k - 1, k - 2] - turn[:, k - 2, k - 1] for k in range(3)], axis=-1)
        error = np.concatenate([theta, out.p_camera_body.numpy()[b, i, j] - p], axis=1)
        covariance = out.covariance.numpy()[b, i, j]
        square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
        np.add.at(wrong, b, square > WRONG)
    return wrong


def outcome(fidelity: str, team: str) -> Outcome:
    """Run the plan on one rung."""
    env = exploration_v0.vector_env(TEAMS, "u_turn", team=team, fidelity=fidelity, num_worlds=1, threads=1)
    env.reset(seed=100)
    sightings, wrong, truth = np.zeros(TEAMS, dtype=int), np.zeros(TEAMS, dtype=int), []
    for actions in inchworm_plan(env.batch.actions.shape[1], seed=5):
        env.step(actions)
        sightings += env.batch.measurements.seen.numpy().sum(axis=(1, 2))
        wrong += wrong_sightings(env.batch)
        truth.append(env.batch.state.position.numpy().copy())
    drift = np.array([observer_drift(env.batch, b) for b in range(TEAMS)])
    return Outcome(drift[:, 0], drift[:, 1], sightings, wrong, np.array(truth))


def report(name: str, poses: Outcome, features: Outcome) -> str:
    """Both rungs' figures: `pytest -s` shows them, and so does a failure."""
    rows = [
        f"{fidelity}: drift {one.drift_m.mean():.4f} m, {np.degrees(one.heading_rad.mean()):.3f} deg, "
        f"{one.sightings.sum()} sightings, {one.wrong.sum()} wrong"
        for fidelity, one in (("poses", poses), ("features", features))
    ]
    return f"{name}: " + "; ".join(rows)


@pytest.mark.slow
@pytest.mark.parametrize("team", ["inchworm", "surveyors"])
def test_rungs_are_equivalent_on_the_same_truth(team):
    poses, features = (outcome(fidelity, team) for fidelity in ("poses", "features"))
    told = report(team, poses, features)
    print(told)
    np.testing.assert_array_equal(poses.truth, features.truth)
    assert poses.sightings.sum() > 50 * TEAMS, told
    assert features.sightings.sum() == pytest.approx(poses.sightings.sum(), rel=0.1), told
    assert features.drift_m.mean() == pytest.approx(poses.drift_m.mean(), rel=0.1), told
    assert features.heading_rad.mean() == pytest.approx(poses.heading_rad.mean(), rel=0.1), told
    shares = [one.wrong.sum() / one.sightings.sum() for one in (poses, features)]
    assert abs(shares[0] - shares[1]) < 0.02, told
    lost = [np.mean((one.drift_m > 0.3) | (one.heading_rad > 0.3)) for one in (poses, features)]
    assert abs(lost[0] - lost[1]) < 0.02, told
