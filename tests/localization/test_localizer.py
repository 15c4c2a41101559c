"""Logs of a team whose truth is written down: paths, covariances, and what is said of gaps, losses and liars."""

from __future__ import annotations

import dataclasses
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from coop_envs.errors import ConfigError
from coop_envs.localization.assessment import assess, true_paths
from coop_envs.localization.localizer import localize
from coop_envs.localization.logs.events import Fix, ImuSample, Log, Odometry, PoseSighting, Trajectory
from coop_envs.localization.result import Kind, Result
from coop_envs.localization.settings import Localization
from coop_envs.localization.trajectories import interpolated, nees
from tests.localization.generated_team import NAMES, generated_log

STAMPS = Localization(clocks="stamps")


def kinds(result: Result, robot: str) -> list[Kind]:
    rests = (Kind.REST_BEGINS, Kind.REST_ENDS)
    return [one.kind for one in result.happenings if one.robot == robot and one.kind not in rests]


def same(a: Result, b: Result) -> bool:
    """Equal to the last bit."""
    arrays = ("time_s", "position", "rotation", "covariance")
    paths = a.paths.keys() == b.paths.keys() and all(
        np.array_equal(getattr(a.paths[name], part), getattr(b.paths[name], part))
        for name in a.paths
        for part in arrays
    )
    return paths and a.happenings == b.happenings


def within_bounds(result: Result, log: Log, drift_m: float, worst_nees: float) -> None:
    for name, found in assess(result, log.truth).items():
        assert found.position_drift_m < drift_m, name
        assert found.nees_worst < worst_nees, name


@pytest.mark.parametrize("seeds", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_paths_are_right_and_so_are_their_covariances(seeds):
    """Drift below a hundredth of the path, NEES about its degrees of freedom."""
    values, drift = [], []
    for seed in range(seeds):
        log = generated_log(seed)
        result = localize(log, STAMPS)
        found = assess(result, log.truth)
        values += [one.nees_mean for one in found.values()]
        drift += [one.position_drift_m / one.path_m for one in found.values()]
    assert 0.6 < np.mean(values) < 1.3
    assert np.mean(drift) < 0.006


def test_rests_begin_and_end_where_robots_stop_and_go():
    log = generated_log(increments=1)
    rests = [one for one in localize(log, STAMPS).happenings if one.robot == "picket_0"]
    assert [one.kind for one in rests] == [Kind.REST_BEGINS, Kind.REST_ENDS, Kind.REST_BEGINS]
    assert rests[1].time_s == pytest.approx(2.0, abs=0.15) and rests[2].time_s == pytest.approx(5.0, abs=0.7)


def test_any_order_of_arrival_gives_the_same_bits():
    """Everything up to 0.4 s late, a fifth of it twice, odometry and frames as well."""
    log = generated_log(increments=1)
    log = dataclasses.replace(log, events=[event for event in log.events if event.time_s < 7.0])
    rng = random.Random(5)
    copies = [*log.events, *(event for event in log.events if rng.random() < 0.2)]
    arrivals = sorted(((event.time_s + rng.uniform(0.0, 0.4), k) for k, event in enumerate(copies)))
    shuffled = dataclasses.replace(log, events=[copies[k] for _, k in arrivals])
    in_order, out_of_order = localize(log, STAMPS), localize(shuffled, STAMPS)
    assert same(in_order, out_of_order)
    assert out_of_order.counts["duplicate"] == len(copies) - len(log.events)
    assert out_of_order.counts["late"] == 0 and out_of_order.counts["replayed"] > 100


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 1.5))
def test_however_late_within_the_horizon(seed, late_s):
    log = generated_log(1, increments=1, imu_hz=30.0, odometry=False, silent=[("picket_0", 3.0, 3.8)])
    log = dataclasses.replace(log, events=[event for event in log.events if event.time_s < 4.5])
    rng = random.Random(seed)
    late = sorted(log.events, key=lambda event: event.time_s + rng.uniform(0.0, late_s))
    assert same(localize(log, STAMPS), localize(dataclasses.replace(log, events=late), STAMPS))


def test_robots_without_a_start_join_where_they_are_first_seen():
    log = generated_log(0, starts=("observer_0",), unseen=[("picket_1", 0.0, 4.0)])
    result = localize(log, STAMPS)
    joined = {one.robot: one for one in result.happenings if one.kind is Kind.JOINED}
    assert joined["picket_0"].time_s < 0.1 and joined["picket_1"].time_s == pytest.approx(4.0, abs=0.1)
    assert result.paths["picket_1"].time_s[0] == joined["picket_1"].time_s
    path = result.paths["picket_1"]
    assert np.sqrt(path.covariance[0].diagonal()[3:]).max() < 0.03  # the sighting's, not that of no knowledge
    within_bounds(result, log, 0.01, 5.0)


def test_an_observer_that_is_lost_is_placed_by_a_picket_that_it_sees():
    """An observer that drove blind too long, here by the centimetre, joins again by what it sees."""
    lost = generated_log(0, unseen=[("picket_0", 8.2, 30.0), ("picket_1", 8.2, 13.0)])
    result = localize(lost, dataclasses.replace(STAMPS, lost_m=0.012))
    assert Kind.LEFT in kinds(result, "observer_0") and Kind.BACK in kinds(result, "observer_0")
    back = next(one for one in result.happenings if one.kind is Kind.BACK and one.robot == "observer_0")
    assert back.detail == "placed from picket_1"
    within_bounds(result, lost, 0.03, 8.0)


def test_short_gaps_are_bridged_and_long_ones_said():
    """Nothing is heard of picket 1 for 0.15 s, and of picket 0 for 1.5 s, both on the way; cameras see them."""
    log = generated_log(silent=[("picket_0", 3.0, 4.5), ("picket_1", 6.0, 6.15)])
    result = localize(log, STAMPS)
    assert kinds(result, "picket_0") == [Kind.GAP, Kind.BACK]
    assert kinds(result, "picket_1") == [Kind.BRIDGED]
    within_bounds(result, log, 0.01, 5.0)


def test_a_robot_nobody_hears_or_sees_is_believed_ever_less_and_comes_back():
    log = generated_log(silent=[("picket_0", 2.5, 6.0)], unseen=[("picket_0", 2.5, 7.0)])
    result = localize(log, STAMPS)
    assert kinds(result, "picket_0") == [Kind.GAP, Kind.LEFT, Kind.BACK, Kind.BACK]
    path = result.paths["picket_0"]
    assert not ((path.time_s > 3.6) & (path.time_s < 6.9)).any()
    inside = (path.time_s > 2.55) & (path.time_s < 3.5)
    sigma = np.sqrt(path.covariance[inside][:, 3, 3])
    assert (np.diff(sigma) > 0).all() and sigma[-1] > 0.5
    within_bounds(result, log, 0.01, 5.0)


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 20), marks=pytest.mark.slow)])
def test_liars_lost_frames_and_delays(seeds):
    """A tenth of the poses wrong by decimetres, a third of the frames lost, 200 ms of delay on average."""
    for seed in seeds:
        log = generated_log(seed, outliers=0.1, latency_s=0.2)
        rng = random.Random(seed)
        lost = {event.time_s for event in log.events if isinstance(event, PoseSighting) and rng.random() < 0.3}
        events = [e for e in log.events if not (isinstance(e, PoseSighting) and e.time_s in lost)]
        result = localize(dataclasses.replace(log, events=events), STAMPS)
        assert sum(one.kind is Kind.OUTLIER for one in result.happenings) > 40
        within_bounds(result, log, 0.02, 8.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"odometry": False},
        {"imu_hz": 30.0},
        pytest.param({"imu_hz": 250.0}, marks=pytest.mark.slow),
        {"imu_hz": 100.0},
        {"frame_hz": 8.0},
    ],
)
def test_streams_of_other_rates_and_without_wheels(changes):
    log = generated_log(7, **changes)
    within_bounds(localize(log, STAMPS), log, 0.012, 6.0)


def test_a_robot_without_an_imu_turns_as_its_wheels_do():
    log = generated_log(2)
    events = [e for e in log.events if not (isinstance(e, ImuSample) and e.robot == "picket_1")]
    result = localize(dataclasses.replace(log, events=events), STAMPS)
    found = assess(result, log.truth)
    assert all(one.position_drift_m < 0.02 for one in found.values())


def test_clocks_apart_cost_little_once_they_are_found():
    clocks = {"observer_0": 0.06, "picket_0": -0.08, "picket_1": 0.05}
    log = generated_log(3, increments=3, imu_hz=50.0, turn_rad=1.5, clock_s=clocks)
    result = localize(log, Localization())
    assert set(result.clock_offset_s) == {f"imu {name}" for name in NAMES}
    within_bounds(result, log, 0.012, 6.0)
    blind = assess(localize(log, STAMPS), log.truth)
    assert max(one.nees_worst for one in blind.values()) > 8.0


def moved(truth: dict[str, Trajectory], R: np.ndarray, p: np.ndarray) -> dict[str, Trajectory]:
    return {name: Trajectory(one.time_s, one.position @ R.T + p, R @ one.rotation) for name, one in truth.items()}


@pytest.mark.parametrize("whole", [False, True])
def test_fixes_place_the_team_in_the_world(whole):
    """Three positions at a time, or the observer's pose, and from then on the paths are the world's."""
    log = generated_log(1)
    R, p = Rotation.from_euler("z", 0.7).as_matrix(), np.array([10.0, -4.0, 2.0])
    world, rng = moved(dict(log.truth), R, p), np.random.default_rng(0)
    at, fixes = 1.2, []
    for name in NAMES[:1] if whole else NAMES:
        pose = interpolated(world[name], np.array([at]))
        C = np.diag([0.01**2] * 3 + [0.005**2] * 3) if whole else np.eye(3) * 0.005**2
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.01, 3)).as_matrix() @ pose.rotation[0] if whole else None
        fixes.append(Fix(at, name, pose.position[0] + rng.normal(0.0, 0.005, 3), turn, C))
    events = sorted([*log.events, *fixes], key=lambda event: event.time_s)
    result = localize(dataclasses.replace(log, events=events), STAMPS)
    assert result.frame == "world" and Kind.PLACED in [one.kind for one in result.happenings]
    for name, path in result.paths.items():
        assert path.time_s[0] == pytest.approx(at)
        assert np.nanmax(nees(path, path.covariance, world[name])) < 30.0
        end = interpolated(world[name], path.time_s[-1:])
        assert np.linalg.norm(end.position[0] - path.position[-1]) < 0.05
    assert true_paths(result, world, "observer_0") == world


def test_events_of_strangers_are_refused():
    log = generated_log(increments=1)
    stranger = ImuSample(1.0, "picket_7", np.zeros(3), np.zeros(3))
    with pytest.raises(ConfigError, match=r"robot: got 'picket_7', expected one of observer_0, picket_0, picket_1"):
        localize(dataclasses.replace(log, events=[*log.events, stranger]), STAMPS)
    blind = PoseSighting(1.0, "picket_0", "picket_1", np.eye(3), np.ones(3), np.eye(6))
    with pytest.raises(ConfigError, match=r"poses\.camera: got 'picket_0', expected a robot with a camera"):
        localize(dataclasses.replace(log, events=[*log.events, blind]), STAMPS)
    broken = ImuSample(1.0, "picket_1", np.array([0.0, np.nan, 0.0]), np.zeros(3))
    with pytest.raises(ConfigError, match=r"imu\.gyro: got array.*nan.*, expected finite numbers"):
        localize(dataclasses.replace(log, events=[*log.events[:50], broken]), STAMPS)
    with pytest.raises(ConfigError, match=r"clocks: got 'arrivals', expected a log with arrival_s"):
        localize(log, Localization(clocks="arrivals"))


def test_a_log_of_odometry_alone_is_planar():
    log = generated_log(increments=1)
    rows = [event for event in log.events if isinstance(event, Odometry)]
    assert localize(dataclasses.replace(log, events=rows)).planar


def test_progress_reaches_the_end():
    shares = []
    localize(generated_log(increments=1), STAMPS, shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0 and len(shares) > 10
