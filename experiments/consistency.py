"""How honest our filter is: drift against what its covariance allows, with cameras and hats that are off, and NEES.

On the U-turn with white noise alone, and with focal lengths 0.5 % and LEDs 1 mm off; the filter then either trusts its
calibration or estimates it. The thesis shows no such figures: it gives its filter's drift alone, 2.75 % of the path.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_envs.estimation.team_filter import TeamFilter
from experiments.comparison import Comparison, Tick, silent
from experiments.inchworm_driver import OBSERVER
from experiments.inchworm_streams import Streams
from experiments.localization_study import PLANAR, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

EVERY_TICKS, SETTLED_S = 6, 3.0
BAND = (0.84, 1.25)
FOCAL_SHARE, HAT_M = 0.005, 0.001
OFF = (("sensing.calibration.focal_share", FOCAL_SHARE), ("sensing.calibration.hat_m", HAT_M))
WHITE = replace(PLANAR, pixel_noise_px=0.5, shake_rad=0.0)
CALIBRATING = {"focal_sigma": FOCAL_SHARE, "hat_sigma_m": HAT_M}
CASES: dict[str, tuple[Setting, dict[str, Any]]] = {
    "white noise": (WHITE, {"wheels": False}),
    "white noise, wheels": (WHITE, {}),
    "calibration off, trusted": (replace(WHITE, changes=OFF), {"wheels": False}),
    "calibration off, estimated": (replace(WHITE, changes=OFF), {"wheels": False, **CALIBRATING}),
}


@dataclass(frozen=True)
class Config:
    """Teams driven for each case."""

    seeds: int = 12


@dataclass(frozen=True)
class Case:
    """Of S teams: the observer's drift, path and variance (S,) at the end; NEES/6 (K, S, N) at times (K,)."""

    drift_m: Array
    path_m: Array
    allowed_m2: Array
    time_s: Array
    nees: Array

    @property
    def over_bound(self) -> float:
        """RMS drift over what the covariance allows."""
        return float(np.sqrt(np.mean(self.drift_m**2) / np.mean(self.allowed_m2)))

    @property
    def percent_of_path(self) -> float:
        """Median drift."""
        return float(np.median(100.0 * self.drift_m / self.path_m))

    def share_in_band(self, robot: int) -> float:
        """Percent of settled instants at which the teams' mean NEES/6 is in the band."""
        mean = np.nanmean(self.nees[self.time_s >= SETTLED_S, :, robot], axis=1)
        return float(100.0 * np.mean((mean >= BAND[0]) & (mean <= BAND[1])))


@dataclass(frozen=True)
class Table:
    """The cases by name."""

    cases: Mapping[str, Case]
    title: str = "Drift against its bound, and consistency, over the U-turn"

    @property
    def comparisons(self) -> list[Comparison]:
        rows: list[Comparison] = []
        for name, case in self.cases.items():
            rows.append(Comparison(f"{name}: drift, median", "% of path", case.percent_of_path, 2.75))
            rows.append(Comparison(f"{name}: RMS drift over the covariance's", "", case.over_bound))
            for robot, who in enumerate(("observer", "picket 1", "picket 2")):
                rows.append(Comparison(f"{name}: instants with NEES/6 in band, {who}", "%", case.share_in_band(robot)))
        return rows

    @property
    def notes(self) -> Sequence[str]:
        seeds = len(next(iter(self.cases.values())).drift_m)
        return (f"{seeds} teams; band {BAND[0]} to {BAND[1]}, from {SETTLED_S:g} s on. Thesis: its drift on the ramp.",)


def run(config: Config | None = None, tick: Tick = silent) -> Table:
    """Drive all cases."""
    seeds = (config or Config()).seeds
    cases: dict[str, Case] = {}
    for k, (name, (setting, changes)) in enumerate(CASES.items()):
        cases[name] = _follow(setting.open(seeds), changes, lambda share, k=k: tick((k + share) / len(CASES)))
    return Table(cases)


def _follow(streams: Streams, changes: Mapping[str, Any], tick: Tick) -> Case:
    settings = replace(streams.scenario.estimation, **changes)
    followed = TeamFilter(
        streams.scenario.team, settings, streams.measurements, streams.command, running=streams.running
    )
    followed.reset(streams.starts)
    times: list[float] = []
    nees: list[Array] = []
    while streams.step():
        followed.step(streams.tick_s)
        if streams.ticks % EVERY_TICKS == 0:
            times.append(streams.time_s)
            nees.append(np.where(streams.driver.done[:, None], np.nan, _nees(streams, followed)))
            tick(streams.share)
    gone = _errors(streams, followed)[:, OBSERVER, 3:]
    allowed = np.trace(followed.belief.pose_covariance.numpy()[:, OBSERVER, 3:, 3:], axis1=-2, axis2=-1)
    drift_m = np.linalg.norm(gone, axis=-1)
    return Case(drift_m, streams.path_m()[:, OBSERVER], allowed.copy(), np.array(times), np.array(nees))


def _errors(streams: Streams, followed: TeamFilter) -> Array:
    """(S, N, 6) theta and p, the truth against the belief."""
    position, rotation = streams.truth()
    turn = rotation @ np.swapaxes(followed.belief.rotation.numpy(), -1, -2)
    theta = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(position.shape)
    return np.concatenate([theta, position - followed.belief.position.numpy()], axis=-1)


def _nees(streams: Streams, followed: TeamFilter) -> Array:
    """(S, N) squared errors over the covariance and their six degrees of freedom."""
    e = _errors(streams, followed)
    white = np.linalg.solve(followed.belief.pose_covariance.numpy(), e[..., None])[..., 0]
    return np.sum(e * white, axis=-1) / 6.0


def plot(table: Table) -> Figure:
    """NEES/6 of the observer over time, and drift as a share of the path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), layout="constrained", dpi=144)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for name, case in table.cases.items():
        left.plot(case.time_s, np.nanmean(case.nees[:, :, OBSERVER], axis=1), label=name, linewidth=1.0)
    left.axhspan(*BAND, color="#58b368", alpha=0.2)
    left.set(xlabel="time (s)", ylabel="NEES / 6 of the observer", yscale="log")
    left.legend(fontsize=7)
    shares = [100.0 * case.drift_m / case.path_m for case in table.cases.values()]
    right.boxplot(shares, orientation="horizontal", widths=0.6)
    right.set_yticks(range(1, len(shares) + 1), list(table.cases), fontsize=7)
    right.set(xlabel="drift of the observer (% of its path)")
    return figure
