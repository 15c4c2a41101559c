"""The two drives of chapter 5: what the streams show, and how far filters drift over them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coop_envs.errors import ConfigError
from experiments.contenders import BLIND_, CAMERA, ENTRIES, ONE, OURS, TWO, WHEELS, ours, thesis
from experiments.inchworm_driver import u_turn
from experiments.inchworm_streams import Streams
from experiments.localization_study import PLANAR, UNEVEN, Outcome, Study, crew, median_interval, ratios, run_study

SHORT = replace(PLANAR, plan=replace(u_turn(), stops_m=u_turn().stops_m[:3]))


@pytest.fixture(scope="module")
def short():
    """Two increments by all filters."""
    return run_study(SHORT, ENTRIES, seeds=3)


def test_every_filter_follows_the_first_increments(short):
    assert set(short.outcomes) == set(ENTRIES)
    assert np.allclose(short.path_m[:, 0], 0.98, atol=0.05)
    for name, outcome in short.outcomes.items():
        assert outcome.position_m.shape == (3, 3, 3)
        assert np.max(outcome.drift_cm()) < (10.0 if name in (CAMERA, BLIND_) else 3.0)
        assert np.linalg.norm(outcome.track[:, 0] - short.truth[:, 0], axis=-1).max() < 0.4
    assert np.median(short.outcomes[OURS].drift_cm()) < np.median(short.outcomes[TWO].drift_cm())


def test_a_study_ends_where_its_tracks_do(short):
    assert short.duration_s == short.time_s[-1]
    assert np.all(np.diff(short.time_s) > 0)
    for outcome in short.outcomes.values():
        end_m = outcome.track[-1] - short.truth[-1]
        assert np.allclose(end_m, outcome.position_m[0], atol=0.01)


def test_one_always_rests_in_truth_and_teams_do_not_meet_each_other():
    alone, both = (Streams(SHORT.load(), SHORT.plan, teams, seed=5) for teams in (1, 2))
    while both.step():
        alone.step()
        told = np.abs(both.command.wheels.numpy()).max(axis=-1) > 0
        assert np.all(told.sum(axis=1) < 3)
        np.testing.assert_array_equal(alone.truth()[0][0], both.truth()[0][0])
        np.testing.assert_array_equal(alone.measurements.seen.numpy()[0], both.measurements.seen.numpy()[0])


def test_on_the_rocks_the_observer_sees_nobody_for_a_while():
    plan = replace(UNEVEN.plan, stops_m=UNEVEN.plan.stops_m[:3])
    streams = replace(UNEVEN, plan=plan, worlds=1).open(1)
    blind = 0
    while streams.step():
        x = float(streams.physics.state.position.numpy()[0, 0, 0])
        drives = bool(np.any(streams.command.wheels.numpy()[0, 0]))
        if drives and 0.72 < x < 1.78:
            assert not streams.measurements.seen.numpy().any()
            blind += 1
    assert blind * streams.tick_s > 1.0


def test_dead_reckoning_drifts_and_pickets_help():
    study = run_study(SHORT, {"none": ours(wheels=True, pickets=0), "two": ours(wheels=True)}, seeds=4)
    none, two = (np.median(study.outcomes[name].drift_cm()) for name in ("none", "two"))
    assert two < 0.5 * none


def outcome_of(cm, deg):
    position = np.zeros((len(cm), 1, 3))
    position[:, 0, 0] = np.array(cm) / 100.0
    return Outcome(position, np.deg2rad(np.array(deg))[:, None], np.zeros((1, 1, 3)), np.zeros((1, 1)))


def test_ratios_and_intervals_of_known_drifts():
    study = Study(
        {OURS: outcome_of([1.0, 1.0, 2.0], [0.1, 0.2, 0.3]), TWO: outcome_of([3.0, 4.0, 5.0], [0.4, 0.6, 0.9])},
        *(np.zeros(1) for _ in range(3)),
        duration_s=1.0,
    )
    assert ratios(study, OURS) == pytest.approx((4.0, 3.0))
    values = np.random.default_rng(1).normal(5.0, 1.0, 200)
    middle, low, high = median_interval(values)
    assert middle == np.median(values)
    assert 0.1 < high - low < 0.6
    assert low < middle < high
    assert median_interval(np.array([2.0])) == (2.0, 2.0, 2.0)


def test_no_teams_are_refused():
    with pytest.raises(ConfigError, match="seeds: got 0, expected 1 to 1000"):
        run_study(PLANAR, {}, 0)


@pytest.mark.slow
def test_the_thesis_filter_drifts_as_far_as_the_thesis_says_and_ours_far_less():
    entries = {name: ENTRIES[name] for name in (CAMERA, ONE, TWO, OURS, WHEELS)}
    study = run_study(PLANAR, entries, seeds=100)
    drift = {name: outcome.drift_cm() for name, outcome in study.outcomes.items()}
    angle = {name: outcome.drift_deg() for name, outcome in study.outcomes.items()}
    assert rms(drift[TWO]) == pytest.approx(3.49, rel=0.15)
    assert rms(angle[TWO]) == pytest.approx(1.54, rel=0.25)
    for values in (drift, angle):
        assert ordered(values[TWO], values[ONE]) and ordered(values[ONE], values[CAMERA])
    for name in (OURS, WHEELS):
        position, heading = ratios(study, name)
        assert position >= 3.0 and heading >= 2.0


@pytest.mark.slow
def test_on_the_ramp_ours_drifts_far_less_than_the_thesis_filter():
    study = run_study(UNEVEN, {TWO: thesis(), WHEELS: ours(wheels=True), OURS: ours(wheels=False)}, seeds=100)
    assert 9.0 < rms(study.outcomes[TWO].drift_cm()) < 18.0
    assert 1.5 < rms(study.outcomes[TWO].drift_deg()) < 3.5
    for name in (OURS, WHEELS):
        position, heading = ratios(study, name)
        assert position >= 3.0 and heading >= 2.0


@pytest.mark.slow
def test_drift_falls_with_the_number_of_pickets():
    one, four = (run_study(crew(n), {OURS: ours(wheels=False)}, 40).outcomes[OURS] for n in (1, 4))
    assert median_interval(four.drift_deg())[2] < median_interval(one.drift_deg())[1]
    assert rms(four.drift_cm()) < rms(one.drift_cm())


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def ordered(less, more):
    """Whether the root mean square of paired values is less, with 97.5 % of bootstrap samples."""
    pick = np.random.default_rng(0).integers(0, len(less), (2000, len(less)))
    return np.quantile((less[pick] ** 2).mean(axis=1) / (more[pick] ** 2).mean(axis=1), 0.975) < 1.0
