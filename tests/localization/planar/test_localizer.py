from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.events import Fix, Log, Odometry, RangeBearing
from coop_envs.localization.planar import se2
from coop_envs.localization.planar.localizer import localize_planar
from coop_envs.localization.planar.settings import PlanarSettings
from coop_envs.localization.result import Kind
from tests.localization.planar.generated_logs import LANDMARKS, make_log, path_errors, without


@pytest.fixture(scope="module")
def log():
    return make_log(0)


@pytest.fixture(scope="module")
def alone():
    """Without landmarks."""
    return make_log(0, landmarks={})


def settled_rms_m(result, log):
    found = path_errors(result, log)
    return {name: float(np.sqrt(np.mean(place[t > 5.0] ** 2))) for name, (t, place, _, _) in found.items()}


def worst_nees(result, log):
    return max(float(nees.mean()) for _, _, _, nees in path_errors(result, log).values())


def test_known_landmarks_place_robots_whose_starts_nobody_told(log):
    result = localize_planar(without(log, starts={}))
    assert result.frame == "world" and result.planar and not result.notes
    assert set(result.paths) == set(log.robots)
    assert max(settled_rms_m(result, log).values()) < 0.06
    assert worst_nees(result, log) < 2.5
    placed = [one for one in result.happenings if one.kind is Kind.PLACED]
    assert {one.robot for one in placed} == set(log.robots)


def test_a_team_alone_keeps_to_its_own_frame(alone):
    result = localize_planar(alone)
    assert result.frame == "team"
    assert max(settled_rms_m(result, alone).values()) < 0.25
    assert worst_nees(result, alone) < 2.5


def test_robots_join_where_they_are_seen(alone):
    result = localize_planar(without(alone, starts={"robot_0": alone.starts["robot_0"]}))
    assert {one.robot for one in result.happenings if one.kind is Kind.JOINED} == {"robot_1", "robot_2"}
    assert result.paths["robot_1"].time_s[0] > 0.1
    assert max(settled_rms_m(result, alone).values()) < 0.3
    assert worst_nees(result, alone) < 3.0


def test_without_any_start_the_first_robot_is_the_frame(alone):
    result = localize_planar(without(alone, starts={}))
    x, y, yaw = alone.starts["robot_0"]
    truth, path = alone.truth["robot_1"], result.paths["robot_1"]
    k = np.searchsorted(truth.time_s, path.time_s[-1] - 1e-9)
    expected = se2.seen_from(np.array([x, y, yaw]), truth.position[k, :2])
    np.testing.assert_allclose(path.position[-1, :2], expected, atol=0.3)


def test_unknown_landmarks_are_mapped_and_help(log, alone):
    unknown = without(log, landmarks={})
    result = localize_planar(unknown)
    assert result.frame == "team"
    assert set(result.landmarks) == set(LANDMARKS)
    for name, place in result.landmarks.items():
        np.testing.assert_allclose(place, LANDMARKS[name], atol=0.2)
    errors = settled_rms_m(result, log)
    assert np.mean(list(errors.values())) < np.mean(list(settled_rms_m(localize_planar(alone), alone).values()))


@pytest.mark.parametrize("seeds", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_consistent_over_seeds(seeds):
    """Mean NEES of teams of each kind; each mean over a run's instants, which hang together."""
    found = {"known": [], "unknown": [], "joining": []}
    for seed in range(seeds):
        log, alone = make_log(seed, seconds=12.0), make_log(seed, seconds=12.0, landmarks={})
        first = {"robot_0": log.starts["robot_0"]}
        for kind, one in (
            ("known", without(log, starts={})),
            ("unknown", without(log, landmarks={})),
            ("joining", without(alone, starts=first)),
        ):
            found[kind] += [nees.mean() for _, _, _, nees in path_errors(localize_planar(one), one).values()]
    for kind, values in found.items():
        assert 0.5 < np.mean(values) < 1.6, (kind, np.mean(values))


def test_one_in_ten_sightings_wrong_does_little_harm():
    log = make_log(1, outliers=0.1)
    result = localize_planar(without(log, starts={}))
    wrong = sum(isinstance(event, RangeBearing) for event in log.events) * 0.1
    assert 0.7 * wrong < result.counts["outlier"] < 1.3 * wrong
    assert max(settled_rms_m(result, log).values()) < 0.06


def shuffled(log: Log, seed: int, within_s: float) -> Log:
    """Events in an order in which none is overtaken by more than ``within_s``, one in five of them twice."""
    rng = np.random.default_rng(seed)
    late = [(event.time_s + rng.uniform(0, within_s), k, event) for k, event in enumerate(log.events)]
    again = [(at + rng.uniform(0, 0.2), -k - 1, event) for at, k, event in late if rng.random() < 0.2]
    return without(log, events=[event for _, _, event in sorted(late + again, key=lambda one: one[:2])])


def test_late_and_doubled_events_change_nothing(log):
    short = without(log, events=[event for event in log.events if event.time_s < 6.0], starts={})
    expected = localize_planar(short)
    result = localize_planar(shuffled(short, 3, 0.8))
    assert result.counts["duplicate"] > 50 and result.counts["late"] == 0 and result.counts["replayed"] > 50
    for name, path in expected.paths.items():
        np.testing.assert_array_equal(result.paths[name].time_s, path.time_s)
        np.testing.assert_array_equal(result.paths[name].position, path.position)
        np.testing.assert_array_equal(result.paths[name].covariance, path.covariance)
    assert result.happenings == expected.happenings


@pytest.mark.slow
def test_nobody_gets_lost_with_wrong_lost_and_late_sightings():
    """One sighting in ten wrong, three in ten lost, all late by up to 0.2 s."""
    lost = 0
    for seed in range(40):
        log = make_log(seed, seconds=15.0, outliers=0.1)
        rng = np.random.default_rng(seed)
        kept = [event for event in log.events if not (isinstance(event, RangeBearing) and rng.random() < 0.3)]
        result = localize_planar(shuffled(without(log, events=kept, starts={}), seed, 0.2))
        assert len(result.paths) + len(result.notes) == len(log.robots), seed
        lost += len(result.notes)
        for _, place, _, nees in path_errors(result, log).values():
            assert place[len(place) // 3 :].max() < 0.3, seed
            assert nees[len(nees) // 3 :].mean() < 6.0, seed
    # one that sees next to nothing in 15 s stays unplaced, and a note says so
    assert lost <= 2


def test_the_same_log_gives_the_same_paths(log):
    a, b = localize_planar(log), localize_planar(log)
    for name in log.robots:
        np.testing.assert_array_equal(a.paths[name].position, b.paths[name].position)
        np.testing.assert_array_equal(a.paths[name].covariance, b.paths[name].covariance)


def silenced(log: Log, robot: str, first_s: float, last_s: float) -> Log:
    kept = [
        event
        for event in log.events
        if not (isinstance(event, Odometry) and event.robot == robot and first_s < event.time_s < last_s)
    ]
    return without(log, events=kept)


def test_a_gap_in_odometry_is_told_and_widens_the_pose(alone):
    whole = localize_planar(alone)
    result = localize_planar(silenced(alone, "robot_1", 8.0, 11.0))
    told = {one.kind: one for one in result.happenings if one.robot == "robot_1"}
    assert 8.4 < told[Kind.GAP].time_s < 8.8
    assert told[Kind.BACK].time_s == pytest.approx(11.0, abs=0.06)
    times = result.paths["robot_1"].time_s
    k = int(np.argmin(np.abs(times - 10.9)))
    wide, narrow = (np.trace(one.paths["robot_1"].covariance[k][3:5, 3:5]) for one in (result, whole))
    assert wide > narrow
    assert worst_nees(result, alone) < 3.0


def test_a_robot_that_falls_silent_leaves_and_comes_back(log):
    settings = PlanarSettings(leave_s=3.0)
    result = localize_planar(silenced(without(log, starts={}), "robot_1", 6.0, 13.0), settings)
    kinds = [one.kind for one in result.happenings if one.robot == "robot_1" and one.kind is not Kind.OUTLIER]
    assert kinds == [Kind.PLACED, Kind.GAP, Kind.LEFT, Kind.BACK, Kind.PLACED]
    times = result.paths["robot_1"].time_s
    assert not np.any((times > 10.0) & (times < 13.0))
    assert settled_rms_m(result, log)["robot_1"] < 0.5
    assert result.paths["robot_1"].time_s[-1] > 19.0
    last = path_errors(result, log)["robot_1"][1][-1]
    assert last < 0.1


def fix_of(log: Log, robot: str, time_s: float, whole: bool, world: np.ndarray) -> Fix:
    """A fix in a world in which the log's frame lies at ``world``."""
    truth = log.truth[robot]
    k = int(np.argmin(np.abs(truth.time_s - time_s)))
    R = truth.rotation[k]
    pose = se2.composed(world, np.array([*truth.position[k, :2], np.arctan2(R[1, 0], R[0, 0])]))
    turn = np.eye(3)
    turn[:2, :2] = se2.rotation(pose[2])
    covariance = 1e-4 * np.eye(6 if whole else 3)
    return Fix(float(truth.time_s[k]), robot, np.array([*pose[:2], 0.0]), turn if whole else None, covariance)


@pytest.mark.parametrize("which", [[("robot_0", True)], [("robot_0", False), ("robot_1", False), ("robot_2", False)]])
def test_fixes_place_the_team_and_what_it_did_before(alone, which):
    world = np.array([10.0, -5.0, 1.0])
    fixes = [fix_of(alone, robot, 10.0 + 0.5 * k, whole, world) for k, (robot, whole) in enumerate(which)]
    result = localize_planar(without(alone, events=[*alone.events, *fixes]))
    assert result.counts["late"] == len(fixes)
    events = sorted([*alone.events, *fixes], key=lambda event: event.time_s)
    result = localize_planar(without(alone, events=events))
    assert result.frame == "world"
    for name, path in result.paths.items():
        truth = alone.truth[name]
        assert path.time_s[0] < 1.0
        k = np.searchsorted(truth.time_s, path.time_s - 1e-9).clip(0, len(truth.time_s) - 1)
        apart = np.linalg.norm(se2.acted(world, truth.position[k, :2]) - path.position[:, :2], axis=1)
        assert apart.max() < 0.4
        sigma = np.sqrt(np.trace(path.covariance[:, 3:5, 3:5], axis1=1, axis2=2))
        assert np.mean(apart < 2.5 * sigma) > 0.9


def row(kind, **changes):
    base = {
        Odometry: Odometry(1.0, "robot_0", 0.1, 0.0),
        RangeBearing: RangeBearing(1.0, "robot_0", "robot_1", 1.0, 0.0, 0.1, 0.1),
        Fix: Fix(1.0, "robot_0", np.zeros(3), None, np.eye(3)),
    }[kind]
    return dataclasses.replace(base, **changes)


@pytest.mark.parametrize(
    ("event", "field"),
    [
        (row(Odometry, robot="robot_9"), "robot: got 'robot_9'"),
        (row(Odometry, forward_m_s=np.nan), "forward_m_s: got nan"),
        (row(Odometry, time_s=np.inf), "time_s: got inf"),
        (row(RangeBearing, subject="robot_0"), "range_bearing.subject: got 'robot_0'"),
        (row(RangeBearing, range_m=-1.0), "range_bearing.range_m: got -1.0"),
        (row(RangeBearing, range_sigma_m=0.0), "range_bearing.range_sigma_m: got 0.0"),
        (row(RangeBearing, bearing_rad=np.nan), "bearing_rad: got nan"),
        (row(Fix, covariance=-np.eye(3)), "fixes.covariance"),
        (row(Fix, covariance=np.eye(6)), "fixes.covariance"),
        (row(Fix, covariance=np.full((3, 3), np.nan)), "fixes.covariance"),
        (row(Fix, position=np.array([0.0, np.nan, 0.0])), "position[1]: got nan"),
    ],
)
def test_bad_events_are_refused(alone, event, field):
    with pytest.raises(ConfigError) as told:
        localize_planar(without(alone, events=[*alone.events[:10], event]))
    assert field in str(told.value)
    assert "\n" not in str(told.value)


def test_a_log_without_odometry_is_refused():
    with pytest.raises(ConfigError, match="odometry"):
        localize_planar(Log(("robot_0",), [row(RangeBearing)]))


def test_a_robot_that_nobody_can_place_is_named(alone):
    deaf = [
        event
        for event in alone.events
        if not (isinstance(event, RangeBearing) and "robot_2" in (event.robot, event.subject))
    ]
    first = {"robot_0": alone.starts["robot_0"]}
    result = localize_planar(without(alone, events=deaf, starts=first))
    assert "robot_2" not in result.paths
    assert result.notes == ("robot_2: never placed, no four sightings agreed on where it is",)
