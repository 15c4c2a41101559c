"""What a batch of teams lit with its lasers in a decision: the points that came of it, and the truth beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.batch import TeamBatch
from coop_envs.geometry.terrain import Terrain, cast_ray
from coop_envs.sensing.camera import body_from_camera
from coop_envs.sensing.triangulation import OK

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Indices = NDArray[np.intp]

DEVICE = "cpu"
REACH_M = 20.0


@wp.kernel
def land(
    terrain: Terrain, world: wp.array[int], starts: wp.array[wp.vec3], rays: wp.array[wp.vec3], reach: float,
    way: wp.array[float],
):  # fmt: skip
    """How far each ray goes until it meets something, negative where it does not."""
    k = wp.tid()
    way[k] = cast_ray(terrain, world[k], starts[k], rays[k], reach)


@dataclass(frozen=True, eq=False)
class Shots:
    """The k ticks in which a laser was lit, in the order of time; team frame, m.

    team, time_s
        (k,) which team, and seconds since its start.
    ranged
        (k,) whether two cameras' spots gave a point.
    points, covariance, eyes
        (k, 3), (k, 3, 3), (k, 2, 3) the point and where the belief had the two cameras; NaN without a point.
    landed
        (k, 3) where the ray ended in truth, NaN if it met nothing.
    imaged
        (k,) whether it ended within the images of all of the team's cameras, be it hidden or too dim.
    """

    team: NDArray[np.int64]
    time_s: FloatArray
    ranged: BoolArray
    points: FloatArray
    covariance: FloatArray
    eyes: FloatArray
    landed: FloatArray
    imaged: BoolArray

    def __len__(self) -> int:
        return len(self.team)

    def chosen(self, which: BoolArray) -> Shots:
        """Only those shots."""
        return Shots(*(getattr(self, entry.name)[which] for entry in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Shots]) -> Shots:
        """All shots of several decisions."""
        return cls(*(np.concatenate([getattr(part, entry.name) for part in parts]) for entry in fields(cls)))

    @property
    def error_m(self) -> FloatArray:
        """Distance (k,) of the points from where their rays landed."""
        return np.linalg.norm(self.points - self.landed, axis=1)

    @property
    def normalised_error(self) -> FloatArray:
        """Squared Mahalanobis distance (k,) of the points from where their rays landed, over 3."""
        error = self.points - self.landed
        return np.einsum("ki,ki->k", error, np.linalg.solve(self.covariance, error[..., None])[..., 0]) / 3.0

    def rays(self) -> tuple[FloatArray, FloatArray]:
        """Starts and ends (m, 3) of the rays from both cameras to the points there are."""
        found = self.chosen(self.ranged)
        return found.eyes.reshape(-1, 3), np.repeat(found.points, 2, axis=0)


def read_shots(batch: TeamBatch, since_s: float) -> Shots:
    """The shots of a batch's last decision, which began ``since_s`` after the start."""
    lasers = batch.command.laser.numpy()
    b, t = np.nonzero(lasers.max(axis=1) > 0)
    landed = _landings(batch, b, lasers.argmax(axis=1)[b, t], t)
    found = batch.loop.points
    ranged = found.answer.numpy()[b, t] == OK
    point, covariance = (getattr(found, name).numpy()[b, t].astype(float) for name in ("position", "covariance"))
    eyes = _believed_eyes(batch, b, np.where(ranged[:, None], found.cameras.numpy()[b, t], 0))
    for of_points in (point, covariance, eyes):
        of_points[~ranged] = np.nan
    time_s = np.asarray(since_s + (t + 1) * batch.scenario.rates.tick_s, dtype=np.float64)
    imaged = _imaged(batch, b, landed)
    return Shots(b, time_s, ranged, point, covariance, eyes, _in_team(batch, b, landed), imaged)


def in_world(batch: TeamBatch, team: Indices, points: FloatArray) -> FloatArray:
    """Points (k, 3) of their teams' frames in the world's."""
    frame = batch.state.frame.numpy()[team].astype(float)
    c, s = np.cos(frame[:, 3]), np.sin(frame[:, 3])
    x, y, z = points.T
    return np.column_stack([c * x - s * y, s * x + c * y, z]) + frame[:, :3]


def _in_team(batch: TeamBatch, b: Indices, points: FloatArray) -> FloatArray:
    """World points (k, 3) in their teams' frames."""
    frame = batch.state.frame.numpy()[b].astype(float)
    c, s = np.cos(frame[:, 3]), np.sin(frame[:, 3])
    x, y, z = (points - frame[:, :3]).T
    return np.column_stack([c * x + s * y, c * y - s * x, z])


def _landings(batch: TeamBatch, b: Indices, robot: Indices, t: Indices) -> FloatArray:
    """Where the rays of lit lasers truly end (k, 3), world frame, NaN where they meet nothing."""
    state = batch.state
    azimuth, elevation = state.mirror.numpy()[b, robot, t].astype(float).T
    level = np.cos(elevation)
    rays = np.stack([np.cos(azimuth) * level, np.sin(azimuth) * level, np.sin(elevation)], axis=-1)
    R, p = (getattr(state, name).numpy()[b, robot].astype(float) for name in ("rotation", "position"))
    rays = np.einsum("kij,kj->ki", R, rays)
    mounts = np.array([m.laser.position_m if m.laser else (np.nan,) * 3 for m in batch.scenario.team.members])
    starts = p + np.einsum("kij,kj->ki", R, mounts[robot])
    way = wp.zeros(len(b), dtype=float, device=DEVICE)
    worlds = wp.array(state.world.numpy()[b], dtype=int, device=DEVICE)
    given = [wp.array(a.astype(np.float32), dtype=wp.vec3, device=DEVICE) for a in (starts, rays)]
    inputs = [batch.physics.ground.terrain, worlds, *given, REACH_M, way]
    wp.launch(land, len(b), inputs=inputs, device=DEVICE)
    far = way.numpy().astype(float)
    return starts + rays * np.where(far > 0, far, np.nan)[:, None]


def _believed_eyes(batch: TeamBatch, b: Indices, pair: Indices) -> FloatArray:
    """Where the belief has the cameras of the robots ``pair`` (k, 2): (k, 2, 3), team frame."""
    mounts = np.array([m.camera.position_m if m.camera else (np.nan,) * 3 for m in batch.scenario.team.members])
    R, p = (getattr(batch.belief, name).numpy()[b[:, None], pair] for name in ("rotation", "position"))
    return p + np.einsum("kcij,kcj->kci", R, mounts[pair])


def _imaged(batch: TeamBatch, b: Indices, points: FloatArray) -> BoolArray:
    """Whether world points (k, 3) lie within the images of all cameras; lenses' distortion is left out."""
    within: BoolArray = np.asarray(np.isfinite(points).all(axis=1))
    for robot, member in enumerate(batch.scenario.team.members):
        if (camera := member.camera) is None:
            continue
        R, p = (getattr(batch.state, name).numpy()[b, robot].astype(float) for name in ("rotation", "position"))
        seen = np.einsum("kji,kj->ki", R, points - p) - camera.position_m
        x, y, z = (seen @ body_from_camera(camera.pitch_down_rad)).T
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px
        within = within & (z > 0) & (u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px)
    return within
