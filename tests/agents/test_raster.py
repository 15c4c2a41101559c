"""Rasters as a firmware of counts carries them out: an emulator in plain Python takes what the controller sends."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from coop_envs.agents.catalog import load_team
from coop_envs.agents.command import allocate_command
from coop_envs.agents.control import control, drive_models
from coop_envs.agents.raster import Raster, laser_models, raster_axes
from coop_envs.device import prepare
from coop_envs.geometry.arrays import allocate

TICKS, TICK_S, COUNT_S, COUNT_RAD = 6, 1 / 30, 0.01, 0.01
LIMIT = 78  # counts within 0.785 rad
HOLD, REQUEST, AZIMUTH, ELEVATION, BRIGHTNESS = 0, 4, 5, 6, 7


class Mirror:
    """The Zumy's firmware: a motor runs for as many 10 ms counts as it is told; commands are lost until both stand."""

    def __init__(self, tick_s: float) -> None:
        self.tick_s = tick_s
        self.at, self.left = np.zeros(2), np.zeros(2)
        self.lost = 0

    def tick(self, counts: np.ndarray) -> None:
        if np.any(counts != 0):
            if np.any(np.abs(self.left) > 1e-9):
                self.lost += 1
            else:
                self.left = counts.astype(float)
        run = np.clip(self.left, -self.tick_s / COUNT_S, self.tick_s / COUNT_S)
        self.at, self.left = self.at + run, self.left - run
        self.left[np.abs(self.left) < 1e-9] = 0.0

    @property
    def rests(self) -> bool:
        return not self.left.any()


class Bench:
    """Surveyors that stand, their controllers and one mirror each."""

    def __init__(self, robots: str = "surveyors", tick_s: float = TICK_S) -> None:
        team, device = load_team(robots), prepare("cpu")
        self.n = len(team.members)
        self.command = allocate_command(1, self.n, TICKS, device)
        self.raster: Raster = allocate(Raster, (1, self.n), device)
        self._models = drive_models(team, False, device), laser_models(team, tick_s, device)
        self.mirrors = [Mirror(tick_s) for _ in range(self.n)]
        self.clock = 0
        self.shots: list[tuple[int, int, np.ndarray, bool]] = []  # tick, robot, counts, at rest

    def decide(self, **by_robot: dict[int, float]) -> None:
        """One decision; ``r0={REQUEST: 1.0}`` is robot 0's action besides holding."""
        actions = np.zeros((1, self.n, 8), dtype=np.float32)
        actions[0, :, HOLD] = 1.0
        for name, entries in by_robot.items():
            for k, value in entries.items():
                actions[0, int(name[1:]), k] = value
        flags = np.ones((1, self.n), dtype=np.int32), np.zeros((1, self.n), dtype=np.int32)
        clock = np.array([self.clock], dtype=np.int32)
        inputs = [wp.array(a, device="cpu") for a in (actions, *flags, clock)]
        told = [*inputs, *self._models, self.raster, self.command, wp.ones(1, dtype=int)]
        wp.launch(control, (1, self.n), inputs=told, device="cpu")
        laser, galvo = self.command.laser.numpy()[0], self.command.galvo.numpy()[0]
        for t in range(TICKS):
            for r, mirror in enumerate(self.mirrors):
                mirror.tick(galvo[r, t])
                if laser[r, t] > 0:
                    self.shots.append((self.clock * TICKS + t, r, mirror.at.copy(), mirror.rests))
        self.clock += 1

    def run(self, request: float = 1.0, azimuth: float = 0.0, elevation: float = -0.25) -> None:
        """Decisions until robot 0's raster is done."""
        for _ in range(2000):
            self.decide(r0={REQUEST: request, AZIMUTH: azimuth, ELEVATION: elevation})
            if self.command.scan_progress.numpy()[0, 0] == 1.0:
                return
        raise AssertionError("the raster did not end")


@pytest.fixture
def bench():
    return Bench()


def test_a_raster_covers_its_window_row_by_row_back_and_forth(bench):
    bench.run()
    points = np.array([shot[2] for shot in bench.shots])
    across, down = np.arange(60, -61, -3), np.arange(round(-0.25 * LIMIT) + 24, round(-0.25 * LIMIT) - 25, -3)
    rows = [[(x, y) for x in (across if k % 2 == 0 else across[::-1])] for k, y in enumerate(down)]
    np.testing.assert_allclose(points, np.concatenate(rows), atol=1e-9)


@pytest.mark.parametrize("share", [0.05, 0.1, 0.25, 0.37, 0.5, 1.0])
def test_a_raster_has_the_points_that_are_foretold(bench, share):
    bench.run(request=share)
    laser = load_team("surveyors").members[0].laser
    assert laser is not None
    left, up = raster_axes(laser, share)
    points = np.array([shot[2] for shot in bench.shots]).round(6)
    foretold = {(float(x), float(y)) for x in left for y in up + round(-0.25 * LIMIT)}
    assert {tuple(point) for point in points.tolist()} == foretold and len(points) == len(foretold)


def test_no_move_is_lost_and_the_laser_is_lit_at_rest(bench):
    bench.run()
    bench.run(azimuth=0.5)  # a long way to the next raster
    assert all(mirror.lost == 0 for mirror in bench.mirrors)
    assert all(rests for *_, rests in bench.shots)


@pytest.mark.parametrize("tick_s", [1 / 120, 1 / 100, 1 / 60, 0.1])
def test_no_move_is_lost_at_other_frame_rates(tick_s):
    bench = Bench(tick_s=tick_s)
    bench.run(request=0.2)
    assert all(mirror.lost == 0 for mirror in bench.mirrors)
    assert len(bench.shots) > 20 and all(rests for *_, rests in bench.shots)


def test_one_scanner_takes_a_spot_a_frame(bench):
    bench.run()
    ticks = np.array([shot[0] for shot in bench.shots])
    assert np.all(np.diff(ticks) == 1)


def test_lasers_take_turns_and_moves_hide_in_the_others_turns():
    bench = Bench()
    for _ in range(60):
        bench.decide(r0={REQUEST: 1.0}, r1={REQUEST: 1.0}, r2={REQUEST: 1.0})
    ticks = np.array([shot[0] for shot in bench.shots])
    robots = np.array([shot[1] for shot in bench.shots])
    assert len(set(ticks)) == len(ticks)
    settled = ticks > 90
    assert np.all(np.diff(ticks[settled]) == 1)
    assert np.ptp(np.bincount(robots[settled])) <= 2


def test_a_narrow_request_draws_a_narrow_raster(bench):
    bench.run()
    whole = len(bench.shots)
    bench.shots.clear()
    bench.run(request=0.25)
    points = np.array([shot[2] for shot in bench.shots])
    assert np.ptp(points[:, 0]) == pytest.approx(30, abs=3)
    assert len(points) < whole / 10


def test_a_raster_in_progress_does_not_follow_its_request(bench):
    for k in range(20):
        bench.decide(r0={REQUEST: 1.0, AZIMUTH: 0.01 * k, ELEVATION: -0.25})
    columns = np.array([shot[2] for shot in bench.shots])[:, 0]
    assert columns.max() == 60.0 and np.all(np.diff(columns[:41]) == -3)


def test_the_mirror_is_not_sent_beyond_its_end_stops(bench):
    bench.run(azimuth=1.0, elevation=1.0)
    points = np.array([shot[2] for shot in bench.shots])
    assert points.max() == pytest.approx(LIMIT)
    assert len(np.unique(points.round(6), axis=0)) == len(points), "every point is another one"


def test_hats_are_dark_while_anyone_scans(bench):
    bench.decide(r0={BRIGHTNESS: 1.0}, r1={BRIGHTNESS: 1.0})
    assert bench.command.brightness.numpy()[0, 0] == 1.0
    bench.decide(r0={BRIGHTNESS: 1.0}, r1={REQUEST: 1.0, BRIGHTNESS: 1.0})
    assert not bench.command.brightness.numpy().any()


def test_who_drives_does_not_scan(bench):
    bench.decide(r0={HOLD: 0.0, REQUEST: 1.0})
    assert not bench.command.laser.numpy().any() and not bench.command.galvo.numpy().any()


def test_robots_without_a_laser_ignore_the_request():
    bench = Bench("inchworm")
    bench.decide(r0={REQUEST: 1.0}, r1={REQUEST: 1.0})
    assert not bench.command.laser.numpy().any() and bench.command.brightness.numpy().any()
