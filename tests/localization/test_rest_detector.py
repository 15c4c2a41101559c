"""Rest and motion: against noise whose law is known, and real recordings with a flag for motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_team
from coop_envs.agents.command import allocate_command
from coop_envs.agents.specification import Imu
from coop_envs.errors import ConfigError
from coop_envs.estimation.settings import Estimation
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.localization.rest_detector import (
    CHANCE,
    ImuNoise,
    median_turn,
    noise_of,
    quiet_windows,
    resting,
    specified_noise,
    window_length,
)
from coop_envs.sensing.measurements import allocate_measurements
from tests.localization.broad import NEEDED, TRIALS, recording

NOISE = ImuNoise(0.002, 0.05)
UP = np.array([0.0, 0.0, 9.81])


def still(count: int, seed: int = 0, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    gyro = rng.normal(0.0, scale * NOISE.gyro_rad_s, (count, 3))
    return gyro, UP + rng.normal(0.0, scale * NOISE.accel_m_s2, (count, 3))


def test_noise_as_specified_never_looks_like_motion():
    gyro, accel = still(50_000)
    assert resting(gyro, accel, 100.0, NOISE).all()


def test_the_limit_is_that_of_chi_squared():
    """Noise at the very limit that the ground may shake fails about as seldom as the law says, twice it always."""
    gyro, accel = still(200_000)
    windows = quiet_windows(3.0 * gyro, accel, NOISE, np.zeros(3), 30)
    assert (~windows).mean() == pytest.approx(CHANCE, abs=3.0 * CHANCE)
    assert not quiet_windows(6.0 * gyro, accel, NOISE, np.zeros(3), 30).any()


@pytest.mark.parametrize("rate_hz", [30.0, 100.0, 286.0])
def test_a_push_is_found_to_the_window(rate_hz):
    """Between two rests a turn to and fro: what lies more than a window inside is motion, what lies outside is rest."""
    count = round(6.0 * rate_hz)
    gyro, accel = still(count, 1)
    t = np.arange(count) / rate_hz
    moves = (t >= 2.0) & (t < 4.0)
    gyro[:, 2] += np.where(moves, 0.5 * np.sin(2.0 * np.pi * (t - 2.0)), 0.0)
    found = ~resting(gyro, accel, rate_hz, NOISE)
    assert not found[~moves].any()
    assert found[(t > 2.3) & (t < 3.7)].all()


def test_bias_is_not_motion_and_a_steady_turn_is():
    gyro, accel = still(1000)
    bias = np.array([0.01, -0.02, 0.03])
    assert resting(gyro + bias, accel, 100.0, NOISE).all()
    np.testing.assert_allclose(median_turn(gyro + bias, NOISE, 30), bias, atol=3e-4)
    assert not resting(gyro + 0.05, accel, 100.0, NOISE, bias=np.zeros(3)).any()
    assert not resting(gyro, 1.05 * accel, 100.0, NOISE).any()


def test_noise_is_read_off_the_calmest_part():
    gyro, accel = still(5000, scale=2.0)
    gyro[1000:] += np.random.default_rng(2).normal(0.0, 0.5, (4000, 3))
    found = noise_of(gyro, accel, 100.0, NOISE)
    assert found.gyro_rad_s == pytest.approx(0.004, rel=0.1) and found.accel_m_s2 == pytest.approx(0.1, rel=0.2)
    assert noise_of(100.0 * gyro, accel, 100.0, NOISE).gyro_rad_s == pytest.approx(0.006)
    assert noise_of(gyro[:10], accel[:10], 100.0, NOISE) == NOISE
    with pytest.raises(ConfigError, match=r"noise\.gyro_rad_s: got 0"):
        ImuNoise(0.0, 1.0)


def test_too_few_samples_tell_nothing():
    gyro, accel = still(window_length(100.0) - 1)
    assert not resting(gyro, accel, 100.0, NOISE).any()


@NEEDED
@pytest.mark.parametrize("trial", TRIALS)
def test_rests_of_real_recordings(trial):
    """At most 1 % of what the data set calls rest is called motion, and little motion is called rest."""
    real = recording(trial)
    noise = noise_of(real.gyro, real.accel, real.rate_hz, specified_noise(Imu(), real.rate_hz))
    rests = resting(real.gyro, real.accel, real.rate_hz, noise)
    false_motion, false_rest = (~rests[~real.moves]).mean(), rests[real.moves].mean()
    print(f"{trial}: false motion {100 * false_motion:.2f} %, false rest {100 * false_rest:.2f} %")
    assert false_motion < 0.01 and false_rest < 0.01


@NEEDED
@pytest.mark.parametrize("trial", TRIALS)
def test_gyro_propagation_of_real_recordings(trial):
    """The filter alone, told that the IMU moves, less the bias of the first rest.

    The optical reference itself wobbles by up to 0.26 and 0.55 deg over a second of rest.
    """
    real, ticks = recording(trial), 10
    start = int(np.flatnonzero(real.moves)[0])
    noise = specified_noise(Imu(), real.rate_hz)
    bias = median_turn(real.gyro[:start], noise, window_length(real.rate_hz))
    own = propagated(real, start, ticks, bias)
    at = start + ticks * np.arange(len(own))
    for seconds, worst_deg, rms_deg in ((1.0, 1.5, 0.5), (60.0, 5.0, 5.0)):
        ahead = round(seconds * real.rate_hz / ticks)
        i = np.arange(0, len(own) - ahead, 5)
        i = i[real.known[at[i]] & real.known[at[i + ahead]]]
        felt = np.swapaxes(own[i], 1, 2) @ own[i + ahead]
        seen = np.swapaxes(real.reference[at[i]], 1, 2) @ real.reference[at[i + ahead]]
        off = np.degrees(Rotation.from_matrix(felt @ np.swapaxes(seen, 1, 2)).magnitude())
        print(f"{trial}: {seconds:g} s: rms {np.sqrt((off**2).mean()):.3f}, 95 % {np.quantile(off, 0.95):.3f} deg")
        assert off.max() < worst_deg and np.sqrt((off**2).mean()) < rms_deg


def propagated(real, start: int, ticks: int, bias: np.ndarray) -> np.ndarray:
    """Attitudes (K, 3, 3) from the first motion on, one every ``ticks`` samples, by the team filter's propagation."""
    team = load_team("inchworm")
    alone = dataclasses.replace(team, members=team.members[:1])
    measured, command = (make(1, 1, ticks, "cpu") for make in (allocate_measurements, allocate_command))
    command.wheels.fill_(1.0)
    measured.heard.fill_(1)
    team_filter = TeamFilter(alone, Estimation(wheels=False), measured, command)
    team_filter.reset(np.zeros((1, 1, 3)))
    team_filter.belief.gyro_bias.assign(bias.reshape(1, 1, 3))
    gyro, accel, rotation = measured.gyro.numpy(), measured.accel.numpy(), team_filter.belief.rotation.numpy()
    out = [rotation[0, 0].copy()]
    for k in range(start, len(real.gyro) - ticks, ticks):
        gyro[0, 0], accel[0, 0] = real.gyro[k + 1 : k + 1 + ticks], real.accel[k + 1 : k + 1 + ticks]
        team_filter.step(ticks / real.rate_hz)
        out.append(rotation[0, 0].copy())
    return np.array(out)
