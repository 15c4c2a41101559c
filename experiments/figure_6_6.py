"""Fig. 6.6: the point cloud that two standing robots measure of a wall corner, with the environment's own controller.

Hats are flashed to fix the poses, then the first robot draws a raster, row by row; points are coloured by time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.team import Member
from coop_envs.errors import require
from coop_envs.point_accuracy import surface_distance_m
from coop_envs.scenario import Scenario, load_scenario
from coop_envs.worlds.corner import CornerGeometry
from experiments.comparison import Comparison, Tick, silent
from experiments.shots import FloatArray, Shots, in_world
from experiments.survey import Survey, Sweep

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

QUIET = {"sensing": {"outlier": 0.0}, "scanning": {"false_spot": 0.0}}
WRONG_M = 0.1
TIMES = "viridis"
FLOOR, WALL, BODY, HAT, VIEW, BEAM = "#d9d9d9", "#b9c4cf", "#ffd54a", "#444444", "#8a8a8a", "#d62f2f"


@dataclass(frozen=True)
class Config:
    """The raster of the first robot, how many teams scan, each with noise of its own, and the first one's seed."""

    sweep: Sweep = field(default_factory=lambda: Sweep(elevation_rad=-0.15))
    teams: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        require(self.teams >= 2, "teams", self.teams, "2 or more, for an interval")


@dataclass(frozen=True, eq=False)
class Cloud:
    """All teams' shots; their points (k, 3) in the world, their distances (k,) from the true surfaces; or NaN."""

    shots: Shots
    points_m: FloatArray
    distance_m: FloatArray
    teams: int

    def by_team(self, values: NDArray[Any], which: NDArray[np.bool_]) -> FloatArray:
        """Sums of values (k,) over each team's chosen shots, (B,)."""
        return np.bincount(self.shots.team[which], values[which].astype(float), self.teams).astype(np.float64)

    def share(self, which: NDArray[np.bool_]) -> float:
        """Of the points, how many are these."""
        return float(np.mean(which[self.shots.ranged]))

    def normalised_errors(self) -> FloatArray:
        """Each team's mean normalised error (B,), NaN for one without points."""
        ranged = self.shots.ranged
        with np.errstate(invalid="ignore"):
            return self.by_team(self.shots.normalised_error, ranged) / self.by_team(ranged, ranged)


@dataclass(frozen=True, eq=False)
class Table:
    """Clouds without and with false lights; the scene, and the first team's believed poses (N, 4) in it."""

    quiet: Cloud
    usual: Cloud
    scenario: Scenario
    poses: FloatArray
    title: str = "Fig. 6.6: point cloud of a wall corner"

    @property
    def drawn(self) -> tuple[FloatArray, FloatArray]:
        """Points (k, 3) of the first team as they come with all noise, and when they were lit (k,)."""
        mine = (self.usual.shots.team == 0) & self.usual.shots.ranged
        return self.usual.points_m[mine], self.usual.shots.time_s[mine]

    @property
    def comparisons(self) -> list[Comparison]:
        shots, cloud = self.quiet.shots, self.quiet
        everything, ranged = np.ones(len(shots), dtype=bool), shots.ranged
        counted = (
            ("lit", everything, None),
            ("in both images", shots.imaged, None),
            ("measured", ranged, None),
            ("missed, though in both images", shots.imaged & ~ranged, "some"),
        )
        rows = [
            Comparison(f"points of a raster: {name}", "", float(cloud.by_team(which, which).mean()), thesis)
            for name, which, thesis in counted
        ]
        geometry = self.scenario.environment.geometry
        assert isinstance(geometry, CornerGeometry)
        planes = (0.0, geometry.wall_ahead_m, -geometry.wall_right_m)
        nearest = np.abs(cloud.points_m[:, [2, 0, 1]] - planes).argmin(axis=1)
        rows += [
            Comparison(f"points measured: {name}", "%", 100 * cloud.share(nearest == plane), "shown")
            for plane, name in enumerate(("on the floor", "on the wall ahead", "on the wall on the right"))
        ]
        rows += _quantiles("from the true surface", cloud.distance_m[ranged])
        rows += _quantiles("from where the laser landed", shots.error_m[ranged])
        errors = cloud.normalised_errors()
        errors = errors[np.isfinite(errors)]
        half = 1.96 * float(errors.std(ddof=1)) / math.sqrt(len(errors))
        ghosts = self.usual.share(self.usual.shots.error_m > WRONG_M)
        rows += [
            Comparison("consistency: mean normalised error", "", float(errors.mean())),
            Comparison("consistency: 95 % interval, plus or minus", "", half),
            Comparison("consistency: farther off than 0.1 m", "%", 100 * cloud.share(shots.error_m > WRONG_M)),
            Comparison("consistency: the same, with false lights", "%", 100 * ghosts),
        ]
        return rows

    @property
    def notes(self) -> Sequence[str]:
        return (
            f"{self.quiet.teams} teams, each with noise of its own, without false lights unless a row says so. The",
            "thesis has no numbers. Normalised error: squared Mahalanobis distance from where the laser landed over 3,",
            "expected: 0.9 to 1.1. The picture shows one team, false lights included.",
        )


def run(config: Config | None = None, tick: Tick = silent) -> Table:
    """Let all teams scan, without false lights and with."""
    config = config or Config()
    quiet, _ = _scanned(config, load_scenario("corner", fidelity="features", **QUIET))
    tick(0.5)
    scenario = load_scenario("corner", fidelity="features")
    usual, poses = _scanned(config, scenario)
    tick(1.0)
    return Table(quiet, usual, scenario, poses)


def _scanned(config: Config, scenario: Scenario) -> tuple[Cloud, FloatArray]:
    """The clouds of all teams, and the first one's believed poses (N, 4)."""
    survey = Survey(scenario, config.seed, config.teams)
    survey.flash("poses")
    survey.scan("scan", 0, config.sweep)
    shots = Shots.joined([decision.shots for decision in survey.log])
    points, distance = in_world(survey.batch, shots.team, shots.points), np.full(len(shots), np.nan)
    distance[shots.ranged] = surface_distance_m(survey.world, points[shots.ranged])
    return Cloud(shots, points, distance, config.teams), _poses(survey)


def _poses(survey: Survey) -> FloatArray:
    """The first team's believed poses (N, 4) in the world: x, y, z, yaw."""
    R, p = (getattr(survey.batch.belief, name).numpy()[0] for name in ("rotation", "position"))
    place = in_world(survey.batch, np.zeros(len(p), dtype=np.intp), p)
    return np.column_stack([place, np.arctan2(R[:, 1, 0], R[:, 0, 0]) + float(survey.batch.state.frame.numpy()[0, 3])])


def _quantiles(name: str, values: FloatArray) -> list[Comparison]:
    return [Comparison(f"points' distance: {name}, {label}", "mm", 1e3 * float(np.quantile(values, q)))
            for label, q in (("median", 0.5), ("95 %", 0.95))]  # fmt: skip


def plot(table: Table) -> Figure:
    """The thesis's panels: scene, cloud, top view, front and side views."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 9.0), layout="constrained", dpi=144)
    halves: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.15))
    above, below = halves
    geometry = table.scenario.environment.geometry
    assert isinstance(geometry, CornerGeometry)
    scene: Any = above.add_subplot(1, 2, 1, projection="3d")
    cloud: Any = above.add_subplot(1, 2, 2, projection="3d")
    _box(scene, geometry, "(a) the scene")
    _draw_scene(scene, table, geometry)
    _box(cloud, geometry, "(b) the point cloud")
    points, time_s = table.drawn
    cloud.scatter(*points.T, c=time_s, cmap=TIMES, s=3, depthshade=False)
    views = below.subplot_mosaic("TF;TS", width_ratios=(1.0, 1.1))
    drawn = _draw_view(views["T"], table, geometry, 0, 1, "(c) from above")
    _draw_view(views["F"], table, geometry, 1, 2, "(d) from the front: along x")
    _draw_view(views["S"], table, geometry, 0, 2, "from the side: along y")
    bar = below.colorbar(drawn, ax=list(views.values()), location="bottom", shrink=0.5, aspect=50)
    bar.set_label("time since the hats were lit (s)", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    return figure


def _box(axes: Any, geometry: CornerGeometry, title: str) -> None:
    axes.set_title(title, fontsize=10)
    low = np.array([-geometry.behind_m, -geometry.wall_right_m, 0.0])
    high = np.array([geometry.wall_ahead_m, geometry.left_m, geometry.wall_height_m])
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.15)
    axes.computed_zorder = False
    axes.view_init(elev=32, azim=-205)
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)
    axes.set_zticks([0.0, geometry.wall_height_m])
    axes.tick_params(labelsize=7)


def _draw_scene(axes: Any, table: Table, geometry: CornerGeometry) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    back, ahead, right, left = -geometry.behind_m, geometry.wall_ahead_m, -geometry.wall_right_m, geometry.left_m
    floor, top = 0.0, geometry.wall_height_m
    faces = [
        [(back, right, floor), (ahead, right, floor), (ahead, left, floor), (back, left, floor)],
        [(ahead, right, floor), (ahead, left, floor), (ahead, left, top), (ahead, right, top)],
        [(back, right, floor), (ahead, right, floor), (ahead, right, top), (back, right, top)],
    ]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=[FLOOR, WALL, WALL], alpha=0.6, zorder=0))
    for k, (member, pose) in enumerate(zip(table.scenario.team.members, table.poses, strict=True)):
        x, y, z, _ = pose
        axes.plot([x, x], [y, y], [z - 0.05, z + 0.07], color=BODY, linewidth=7, solid_capstyle="butt")
        axes.text(x, y, z + 0.22, f"R{k}", fontsize=8, ha="center")
        axes.add_collection3d(Line3DCollection(_pyramid(member, pose), colors=VIEW, linewidths=0.8))
    laser = table.scenario.team.members[0].laser
    assert laser is not None
    points, _ = table.drawn
    start, end = table.poses[0, :3] + np.array([0.0, 0.0, laser.position_m[2]]), points[len(points) // 3]
    axes.plot(*np.column_stack([start, end]), color=BEAM, linewidth=1.0)


def _pyramid(member: Member, pose: FloatArray, far_m: float = 1.2) -> list[FloatArray]:
    """The edges of a camera's field of view, team frame."""
    camera = member.camera
    assert camera is not None
    wide, high = 0.5 * camera.width_px / camera.fx_px, 0.5 * camera.height_px / camera.fy_px
    c, s = math.cos(pose[3]), math.sin(pose[3])
    eye = pose[:3] + np.array(camera.position_m) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    corners = [eye + far_m * np.array([c - s * u, s + c * u, v])
               for u, v in ((wide, high), (-wide, high), (-wide, -high), (wide, -high))]  # fmt: skip
    return [*(np.array([eye, corner]) for corner in corners), np.array([*corners, corners[0]])]


def _draw_view(axes: Axes, table: Table, geometry: CornerGeometry, across: int, up: int, title: str) -> Any:
    """Points along the remaining axis; y grows to the left where one looks ahead."""
    points, time_s = table.drawn
    drawn = axes.scatter(points[:, across], points[:, up], c=time_s, cmap=TIMES, s=4)
    if up == 1:
        x, y, _, yaw = table.poses.T
        axes.quiver(x, y, np.cos(yaw), np.sin(yaw), color=HAT, width=0.006, scale=9, zorder=3)
        axes.scatter(x, y, c=BODY, edgecolors=HAT, s=45, zorder=4)
        for k, (px, py) in enumerate(zip(x, y, strict=True)):
            axes.annotate(f"R{k}", (px, py), xytext=(-12, 6), textcoords="offset points", fontsize=8)
        axes.plot(
            [-geometry.behind_m, geometry.wall_ahead_m, geometry.wall_ahead_m],
            [-geometry.wall_right_m, -geometry.wall_right_m, geometry.left_m],
            color=WALL,
            linewidth=2,
            zorder=0,
        )
    else:
        axes.axhline(0.0, color=WALL, linewidth=2, zorder=0)
    if across == 1:
        axes.invert_xaxis()
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(f"{'xyz'[across]} (m)", fontsize=8)
    axes.set_ylabel(f"{'xyz'[up]} (m)", fontsize=8)
    axes.set_aspect("equal", adjustable="datalim" if up == 2 else "box")
    axes.tick_params(labelsize=7)
    axes.grid(visible=True, color="#e9e9e9", linewidth=0.6)
    axes.set_axisbelow(True)
    return drawn
