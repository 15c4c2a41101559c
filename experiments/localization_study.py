"""Filters side by side on the streams of chapter 5's two experiments: where each believes its team to be at the end.

The thesis tells neither how its robots shook nor how noisy its sensors were. So the noise of the streams is chosen such
that the thesis's own filter, with its authors' settings, drifts about as far as the thesis says (`PLANAR`, `UNEVEN`);
then every other filter sees the same streams.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import bootstrap

from coop_envs.errors import require
from coop_envs.scenario import Scenario, load_scenario
from experiments.comparison import Tick, silent
from experiments.contenders import ENTRIES, TWO, Contender, Entry
from experiments.inchworm_driver import OBSERVER, Plan, Style, post_of, ramp, straight, u_turn
from experiments.inchworm_streams import Blind, Streams

Array = NDArray[np.float64]

TRACK_EVERY = 3
STRAIGHT = (
    ("environment.geometry.size_m", (9.0, 3.0)),
    ("environment.geometry.start", (-4.0, 0.0, 0.0)),
    ("fidelity", "poses"),
)
QUIET: dict[str, Any] = {
    "fidelity": "features",
    "rates.ticks_per_decision": 1,
    "sensing.outlier": 0.0,
    "sensing.false_lights": 0.0,
}


@dataclass(frozen=True)
class Setting:
    """A drive: scenario, plan, worlds, and the noise that was tuned.

    ``pixel_noise_px`` is that of a blob's centroid (bright LEDs in the dark), ``shake_rad`` the camera's about each
    axis while the observer drives, ``gyro_rad_s_rthz`` the gyros' while their robots move. There are no lamps and no
    reflections in the dark room.
    """

    scenario: str
    plan: Plan
    worlds: int = 1
    blind: Blind | None = None
    pixel_noise_px: float = 0.5
    shake_rad: float = 0.0
    gyro_rad_s_rthz: float | None = None
    pickets: int = 2
    changes: tuple[tuple[str, Any], ...] = ()

    def open(self, seeds: int, seed: int = 0) -> Streams:
        """The streams of so many teams."""
        return Streams(self.load(), self.plan, seeds, seed, self.worlds, self.blind)

    def load(self) -> Scenario:
        """The scenario with this noise and so many pickets."""
        scenario = load_scenario(self.scenario, **(QUIET | dict(self.changes)))
        if self.pickets != 2:
            hat = {"role": "picket", "robot": "zumy", "hat": "zumy", "count": self.pickets}
            members = [{"role": "observer", "robot": "zumy", "cameras": ["lifecam"]}, hat]
            scenario = load_scenario(scenario, team={"name": "inchworm", "members": members})
            posts = {f"team.members.{r}.start": post_of(self.plan, r, 0) for r in range(1, self.pickets + 1)}
            scenario = load_scenario(scenario, **posts)
        noise = {"sensing.pixel_noise_px": self.pixel_noise_px}
        changes: dict[str, Any] = noise | {"team.members.0.cameras.0.shake_rad": self.shake_rad}
        for r in range(len(scenario.team.members) if self.gyro_rad_s_rthz is not None else 0):
            changes[f"team.members.{r}.robot.imu.moving_gyro_noise_rad_s_rthz"] = self.gyro_rad_s_rthz
        return load_scenario(scenario, **changes)


@dataclass(frozen=True)
class Config:
    """Teams driven for each row; figures show the first."""

    seeds: int = 12


PLANAR = Setting("u_turn", u_turn(), pixel_noise_px=0.2, shake_rad=0.0046)
UNEVEN = Setting("ramp", ramp(), worlds=8, blind=Blind(0.7, 1.8), gyro_rad_s_rthz=0.012)


def moving(style: Style) -> Setting:
    """The U-turn with another way to move."""
    return replace(PLANAR, plan=u_turn(2, style))


def crew(pickets: int) -> Setting:
    """Five metres straight on with so many pickets, all told apart: eight hats share hues, which misleads solvers."""
    return replace(PLANAR, plan=straight(pickets), pickets=pickets, changes=STRAIGHT)


@dataclass(frozen=True)
class Outcome:
    """Errors at the end over S teams: position (S, N, 3) in m, angle (S, N) in rad; the first team's track.

    ``track`` (K, N, 3) and ``track_angle`` (K, N) are beliefs and angle errors at `Study.time_s`.
    """

    position_m: Array
    angle_rad: Array
    track: Array
    track_angle: Array

    def drift_cm(self, robot: int = OBSERVER) -> Array:
        """(S,) distance between belief and truth."""
        return 100.0 * np.linalg.norm(self.position_m[:, robot], axis=-1)

    def drift_deg(self, robot: int = OBSERVER) -> Array:
        """(S,) angle between belief and truth."""
        return np.rad2deg(self.angle_rad[:, robot])


@dataclass(frozen=True)
class Study:
    """Outcomes by contender; the first team's times (K,) and true track (K, N, 3); the paths gone (S, N)."""

    outcomes: Mapping[str, Outcome]
    time_s: Array
    truth: Array
    path_m: Array
    duration_s: float


@dataclass
class _Track:
    """What is kept of the first team on its way."""

    time_s: list[float] = field(default_factory=list)
    truth: list[Array] = field(default_factory=list)
    believed: dict[str, list[Array]] = field(default_factory=dict)
    angle: dict[str, list[Array]] = field(default_factory=dict)

    def note(self, streams: Streams, contenders: Mapping[str, Contender]) -> None:
        position, rotation = streams.truth()
        self.time_s.append(streams.time_s)
        self.truth.append(position[0])
        for name, contender in contenders.items():
            p, R = contender.pose()
            self.believed.setdefault(name, []).append(np.array(p[0]))
            self.angle.setdefault(name, []).append(_apart(R[:1], rotation[:1])[0])


def run_study(setting: Setting, entries: Mapping[str, Entry], seeds: int, tick: Tick = silent) -> Study:
    """Drive so many teams and let every entry follow."""
    require(1 <= seeds <= 1000, "seeds", seeds, "1 to 1000")
    streams = setting.open(seeds)
    contenders = {name: entry(streams) for name, entry in entries.items()}
    track = _Track()
    while streams.step():
        for contender in contenders.values():
            contender.step()
        if streams.ticks % TRACK_EVERY == 0 and not streams.driver.done[0]:
            track.note(streams, contenders)
            tick(streams.share)
    tick(1.0)
    position, rotation = streams.truth()
    outcomes: dict[str, Outcome] = {}
    for name, contender in contenders.items():
        p, R = contender.pose()
        kept = np.array(track.believed[name]), np.array(track.angle[name])
        outcomes[name] = Outcome(p - position, _apart(R, rotation), *kept)
    times = np.array(track.time_s)
    return Study(outcomes, times, np.array(track.truth), streams.path_m(), float(times[-1]))


def _apart(a: Array, b: Array) -> Array:
    """Angle between rotations (B, N, 3, 3), (B, N)."""
    turn = (a @ np.swapaxes(b, -1, -2)).reshape(-1, 3, 3)
    return Rotation.from_matrix(turn).magnitude().reshape(a.shape[:2])


_kept: dict[tuple[Setting, int], Study] = {}


def chapter_5(setting: Setting, seeds: int, tick: Tick = silent) -> Study:
    """All entries on a drive; kept, for several tables and figures show the same."""
    key = setting, seeds
    if key not in _kept:
        _kept[key] = run_study(setting, ENTRIES, seeds, tick)
    return _kept[key]


def median_interval(values: Array) -> tuple[float, float, float]:
    """Median and its 95 % bootstrap interval."""
    if len(values) < 2:
        return float(values[0]), float(values[0]), float(values[0])
    found = bootstrap((values,), np.median, method="percentile", n_resamples=2000, rng=np.random.default_rng(0))
    return float(np.median(values)), float(found.confidence_interval.low), float(found.confidence_interval.high)


def ratios(study: Study, better: str, than: str = TWO, robots: Sequence[int] = (OBSERVER,)) -> tuple[float, float]:
    """By what factor the median drift of position and angle is smaller."""
    a, b = study.outcomes[better], study.outcomes[than]
    position = np.median([b.drift_cm(r) for r in robots]) / np.median([a.drift_cm(r) for r in robots])
    return float(position), float(
        np.median([b.drift_deg(r) for r in robots]) / np.median([a.drift_deg(r) for r in robots])
    )
