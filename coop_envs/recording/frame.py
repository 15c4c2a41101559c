"""What one instant of an episode looks like from the side, truth and belief together, as plain numpy.

The viewer draws a `Frame` over a `WorldPicture`, the recorder writes both. Nothing here decides anything: policies
never see these types.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import ConfigError
from coop_envs.recording.scan import NO_SCAN, Scan

DOCKED, ACTIVE, TRAPPED, SWALLOWED, FALLEN, DEPLETED = range(6)
DECLARED_DOCKED, DECLARED_ACTIVE, DECLARED_LOST = range(3)


_ARRAYS: dict[str, tuple[type[np.generic], tuple[str, ...]]] = {
    "status": (np.int8, ("n",)),
    "declared": (np.int8, ("n",)),
    "true_xy_yaw": (np.float64, ("n", "3")),
    "belief_xy_yaw": (np.float64, ("n", "3")),
    "belief_cov_xy": (np.float64, ("n", "2", "2")),
    "stationary": (np.bool_, ("n",)),
    "collected": (np.bool_, ("n",)),
    "fov_rad": (np.float64, ("n",)),
    "range_m": (np.float64, ("n",)),
    "body_radius_m": (np.float64, ("n",)),
    "sees": (np.bool_, ("n", "n")),
    "scanning": (np.bool_, ("n",)),
    "points_m": (np.float64, ("k", "3")),
    "point_sigma_m": (np.float64, ("k",)),
    "point_robots": (np.int16, ("k", "3")),
    "point_eyes_m": (np.float64, ("k", "2", "3")),
    "map_ground": (np.uint8, ("nx", "ny")),
    "map_obstacle": (np.uint8, ("nx", "ny")),
    "map_volume": (np.uint8, ("levels", "nx", "ny")),
    "T_world_map": (np.float64, ("3",)),
}


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant of an episode with n robots.

    Poses are (x, y, yaw) in metres and radians in the world frame; the belief is brought there from the team frame by
    the first observer's start pose; true poses are NaN where nobody knows them, as of real robots. Map cell ``[i, j]``
    covers the square with lower corner ``cell_m * (i, j)`` in the map frame, which lies in the world at
    ``T_world_map``. Arrays are copied, as the stated types, on construction.

    Raises:
        ConfigError: an array of the wrong shape.
    """

    time_s: float
    names: tuple[str, ...]
    """Agent names, n of them."""
    role: tuple[str, ...]
    """``observer`` or ``picket``, n of them."""
    status: NDArray[np.int8]
    """Truth: 0 docked, 1 active, 2 trapped, 3 swallowed, 4 fallen, 5 depleted; where unknown, what is believed."""
    declared: NDArray[np.int8]
    """Belief: 0 docked, 1 active, 2 lost."""
    true_xy_yaw: NDArray[np.float64]
    belief_xy_yaw: NDArray[np.float64]
    belief_cov_xy: NDArray[np.float64]
    """Covariance of the believed position, m^2, world axes."""
    stationary: NDArray[np.bool_]
    """Declared stationary: a landmark for the others."""
    collected: NDArray[np.bool_]
    """Lost, and taken out of the world by hand."""
    fov_rad: NDArray[np.float64]
    """Horizontal field of view of the robot's camera about its x axis, 0 without a camera."""
    range_m: NDArray[np.float64]
    """How far that camera sees."""
    body_radius_m: NDArray[np.float64]
    sees: NDArray[np.bool_]
    """``sees[i, j]``: the camera of i saw the hat of j in this decision."""
    scanning: NDArray[np.bool_]
    """Draws a raster with its laser."""
    points_m: NDArray[np.float64]
    """Points measured since the frame before, (k, 3); these and the next three are those of a `Scan`."""
    point_sigma_m: NDArray[np.float64]
    point_robots: NDArray[np.int16]
    point_eyes_m: NDArray[np.float64]
    map_ground: NDArray[np.uint8]
    """255 P(the ground carries robots): 128 unknown, 255 proven, 0 hazard."""
    map_obstacle: NDArray[np.uint8]
    """255 P(obstacle): 128 unknown, 0 free."""
    map_volume: NDArray[np.uint8]
    """255 P(something is there), level by level from the lowest; no levels where the frame was taken without."""
    T_world_map: NDArray[np.float64]
    """(x, y, yaw) of the map's lower corner frame."""
    cell_m: float
    volume_floor_m: float
    """Height in the world at which the lowest level begins; a level is as high as a cell."""
    energy_j: float
    action_energy_j: float
    """Motion, laser and LEDs alone; ``energy_j`` is all."""
    information_bits: float
    coverage: float
    """Fraction of the reachable ground that is correctly mapped."""

    def __post_init__(self) -> None:
        lengths = {"n": len(self.names), "2": 2, "3": 3}
        if len(self.role) != len(self.names):
            raise ConfigError("frame.role", self.role, f"{len(self.names)} roles")
        for name, (dtype, axes) in _ARRAYS.items():
            value = np.array(getattr(self, name), dtype=dtype)
            lengths |= {axis: length for axis, length in zip(axes, value.shape, strict=False) if axis not in lengths}
            if value.shape != tuple(lengths.get(axis) for axis in axes):
                raise ConfigError(f"frame.{name}", value.shape, f"shape ({', '.join(axes)}) with {lengths}")
            object.__setattr__(self, name, value)

    @property
    def scan(self) -> Scan:
        """The points measured since the frame before."""
        return Scan(self.points_m, self.point_sigma_m, self.point_robots, self.point_eyes_m)

    def with_scan(self, scan: Scan) -> Frame:
        """The frame with these points in place of its own."""
        return replace(self, **{entry.name: getattr(scan, entry.name) for entry in dataclasses.fields(Scan)})

    def without_maps(self) -> Frame:
        """The frame with maps of no cells."""
        nothing = np.zeros((0, 0), dtype=np.uint8)
        return replace(self, map_ground=nothing, map_obstacle=nothing, map_volume=nothing[None][:0])

    @staticmethod
    def axes(name: str) -> tuple[str, ...]:
        """Names of a field's axes, () for a number."""
        return _ARRAYS[name][1] if name in _ARRAYS else ()


class HazardOutline(Protocol):
    """What is drawn of a hazard: a rectangle of half sizes, turned by yaw, rounded by a radius (metres, radians)."""

    @property
    def kind(self) -> Literal["trap", "hole", "slippery"]: ...
    @property
    def centre_m(self) -> tuple[float, float]: ...
    @property
    def half_size_m(self) -> tuple[float, float]: ...
    @property
    def radius_m(self) -> float: ...
    @property
    def yaw_rad(self) -> float: ...


@dataclass(frozen=True)
class HazardPicture:
    """A hazard's outline, as read back from a log."""

    kind: Literal["trap", "hole", "slippery"]
    centre_m: tuple[float, float]
    half_size_m: tuple[float, float] = (0.0, 0.0)
    radius_m: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class WorldPicture:
    """What is drawn of a world, in the world frame.

    ``heights[i, j]`` (float32, metres, NaN where there is no ground) stands at ``origin + cell * (i, j)``. ``goal`` is
    (x, y, radius) or None, ``starts`` are poses (x, y, yaw), ``bounds`` is (x_min, y_min, x_max, y_max). Instances
    compare and hash by identity, so that pictures of the terrain can be kept.
    """

    heights: NDArray[np.float32]
    origin: tuple[float, float]
    cell: float
    hazards: tuple[HazardOutline, ...]
    goal: tuple[float, float, float] | None
    starts: tuple[tuple[float, float, float], ...]
    bounds: tuple[float, float, float, float]


def frame_to_arrays(frame: Frame) -> dict[str, NDArray[Any]]:
    """Every field of a frame as an array; names and roles become arrays of strings."""
    return {entry.name: np.asarray(getattr(frame, entry.name)) for entry in dataclasses.fields(Frame)}


def frame_from_arrays(arrays: Mapping[str, Any]) -> Frame:
    """The frame that `frame_to_arrays` took apart; lists of numbers serve as well as arrays.

    What is absent of a frame's scan and of the volume is empty.
    """
    cells = np.shape(arrays["map_ground"])
    absent: dict[str, Any] = {
        "scanning": np.zeros(len(arrays["names"]), dtype=np.bool_),
        "map_volume": np.empty((0, *cells), dtype=np.uint8),
        "volume_floor_m": 0.0,
        **{entry.name: getattr(NO_SCAN, entry.name) for entry in dataclasses.fields(Scan)},
    }
    values: dict[str, Any] = {}
    for entry in dataclasses.fields(Frame):
        value = arrays[entry.name] if entry.name in arrays or entry.name not in absent else absent[entry.name]
        if entry.name in _ARRAYS:
            values[entry.name] = value
        elif entry.name in ("names", "role"):
            values[entry.name] = tuple(str(item) for item in value)
        else:
            values[entry.name] = float(value)
    return Frame(**values)


def world_to_arrays(world: WorldPicture) -> dict[str, NDArray[Any]]:
    """A world picture as arrays; hazards become one array a field, a missing goal an empty one."""
    hazards = world.hazards
    return {
        "heights": np.asarray(world.heights, dtype=np.float32),
        "origin": np.asarray(world.origin, dtype=np.float64),
        "cell": np.asarray(world.cell, dtype=np.float64),
        "goal": np.asarray(() if world.goal is None else world.goal, dtype=np.float64),
        "starts": np.asarray(world.starts, dtype=np.float64).reshape(-1, 3),
        "bounds": np.asarray(world.bounds, dtype=np.float64),
        "hazard_kind": np.asarray([h.kind for h in hazards], dtype=np.str_),
        "hazard_centre_m": np.asarray([h.centre_m for h in hazards], dtype=np.float64).reshape(-1, 2),
        "hazard_half_size_m": np.asarray([h.half_size_m for h in hazards], dtype=np.float64).reshape(-1, 2),
        "hazard_radius_m": np.asarray([h.radius_m for h in hazards], dtype=np.float64),
        "hazard_yaw_rad": np.asarray([h.yaw_rad for h in hazards], dtype=np.float64),
    }


def world_from_arrays(arrays: Mapping[str, NDArray[Any]]) -> WorldPicture:
    """The world picture that `world_to_arrays` took apart."""
    columns = [arrays[f"hazard_{name}"].tolist() for name in ("kind", "centre_m", "half_size_m", "radius_m", "yaw_rad")]
    goal = tuple(arrays["goal"].tolist())
    return WorldPicture(
        heights=np.asarray(arrays["heights"], dtype=np.float32),
        origin=tuple(arrays["origin"].tolist()),
        cell=float(arrays["cell"]),
        hazards=tuple(HazardPicture(k, tuple(c), tuple(h), r, y) for k, c, h, r, y in zip(*columns, strict=True)),
        goal=goal or None,
        starts=tuple(tuple(start) for start in arrays["starts"].tolist()),
        bounds=tuple(arrays["bounds"].tolist()),
    )
