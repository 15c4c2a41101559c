"""A 16-bit grey PNG as a world: the brighter a pixel, the higher the ground."""

from __future__ import annotations

import functools
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import WorldError, require
from coop_envs.validation import STRICT
from coop_envs.worlds.mesh_file import MOST_NODES, file_version
from coop_envs.worlds.placement import Footprint, formation_poses
from coop_envs.worlds.siting import FORMATIONS, Traps, require_traps, sited, with_traps
from coop_envs.worlds.world import HeightField, World

FIELD = "environment.geometry.path"
SIGNATURE = b"\x89PNG\r\n\x1a\n"
COLOURS = {0: "grey", 2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}
FULL = 65535
WIDEST_CELL_M = 0.025


@dataclass(frozen=True)
class HeightMapGeometry:
    """Heights ``base_m`` (black) to ``base_m + full_scale_m`` (white, 65535) at pixels ``pixel_m`` apart.

    Columns run along x and rows, from the picture's bottom up, along y: on a screen x points right and y up. The middle
    of the bottom left pixel is (0, 0). Between pixels heights are linear; nodes stand 2.5 cm apart or less.

    ``start`` (x, y, yaw) is the first observer's pose; without it, the largest free ground's longest level view is
    found. ``goal`` is (x, y, radius) or none. ``hazards`` hidden traps are laid out by seed on reachable ground, a walk
    of ``hazard_distance_m`` (least, most) from the start. Only 16-bit grey pictures are taken: 8 bits would make a
    metre of height a stair of 4 mm treads.
    """

    __pydantic_config__ = STRICT
    path: str
    kind: Literal["height_map"] = "height_map"
    pixel_m: float = 0.025
    full_scale_m: float = 1.0
    base_m: float = 0.0
    hazards: int = 6
    hazard_radius_m: tuple[float, float] = (0.15, 0.3)
    hazard_distance_m: tuple[float, float] = (1.0, 8.0)
    start: tuple[float, float, float] | None = None
    goal: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        require(0.001 <= self.pixel_m <= 10, "environment.geometry.pixel_m", self.pixel_m, "0.001 to 10 m")
        scale_fits = np.isfinite(self.full_scale_m) and self.full_scale_m > 0
        require(scale_fits, "environment.geometry.full_scale_m", self.full_scale_m, "a finite height above 0 m")
        require(bool(np.isfinite(self.base_m)), "environment.geometry.base_m", self.base_m, "a finite height in m")
        require_traps(self.hazards, self.hazard_radius_m, self.hazard_distance_m)
        require(self.goal is None or self.goal[2] > 0, "environment.geometry.goal", self.goal, "a radius above 0 m")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """The map with its starts, the same each time, and traps drawn from ``rng``.

        Raises: `WorldError` for a picture that is broken, not 16-bit grey, too small or large, or has no room.
        """
        world = _without_hazards(
            replace(self, path=str(Path(self.path).resolve())), tuple(team), file_version(self.path)
        )
        return with_traps(world, team, Traps(self.hazards, self.hazard_radius_m, self.hazard_distance_m), rng)


def load_heights(path: str) -> NDArray[np.uint16]:
    """Pixel values (nx, ny) of a 16-bit grey PNG: x by column, y by row from the bottom.

    Raises: `WorldError` for a file that is missing, broken, or another kind of picture.
    """
    import cv2

    file = Path(path)
    if file.suffix.lower() != ".png":
        raise WorldError(FIELD, path, "a height map: .png")
    if not file.is_file():
        raise WorldError(FIELD, path, "a file that exists")
    data = file.read_bytes()
    _check_header(path, data)
    pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise WorldError(FIELD, path, "a readable PNG; its pixels cannot be decoded")
    return np.ascontiguousarray(pixels[::-1].T, dtype=np.uint16)


def height_field(values: NDArray[np.uint16], pixel_m: float, full_scale_m: float, base_m: float) -> HeightField:
    """Ground through pixels (nx, ny), with nodes on every pixel and, where they stand wide, between them."""
    from scipy import ndimage

    heights = base_m + values.astype(np.float64) * (full_scale_m / FULL)
    parts = int(np.ceil(pixel_m / WIDEST_CELL_M - 1e-9))
    if parts > 1:
        nx, ny = ((n - 1) * parts + 1 for n in values.shape)
        at = np.meshgrid(np.arange(nx) / parts, np.arange(ny) / parts, indexing="ij")
        heights = ndimage.map_coordinates(heights, at, order=1, mode="nearest")
    return HeightField(heights.astype(np.float32), (0.0, 0.0), pixel_m / parts)


def _check_header(path: str, data: bytes) -> None:
    """Refuse what is no whole 16-bit grey PNG, before anything is unpacked."""
    if not data:
        raise WorldError(FIELD, path, "a PNG, not an empty file")
    if not data.startswith(SIGNATURE) or data[12:16] != b"IHDR" or len(data) < 33:
        raise WorldError(FIELD, path, "a readable PNG; this file is another thing or broken")
    width, height, depth, colour = struct.unpack(">IIBB", data[16:26])
    if colour != 0 or depth != 16:
        got = f"{depth}-bit {COLOURS.get(colour, 'broken')}"
        raise WorldError(FIELD, path, f"a 16-bit grey PNG, heights 0 to 65535, not {got}")
    if width * height > MOST_NODES:
        raise WorldError(FIELD, path, f"at most {MOST_NODES // 10**6} million pixels, not {width} x {height}")
    broken = _broken_part(data)
    if broken:
        raise WorldError(FIELD, path, f"a whole PNG; this file {broken}")


def _broken_part(data: bytes) -> str:
    """What is wrong with the chunks of a PNG, empty where their check sums agree up to its end."""
    at = len(SIGNATURE)
    while at + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            return f"has a damaged chunk {kind.decode('latin-1')}"
        if kind == b"IEND":
            return ""
        at = end
    return "is cut short"


@functools.lru_cache(maxsize=8)
def _without_hazards(geometry: HeightMapGeometry, team: tuple[Footprint, ...], version: tuple[int, int]) -> World:
    """The world of a map and a team before hazards; ``version`` tells a changed file from the one remembered."""
    del version
    values = load_heights(geometry.path)
    size = [(n - 1) * geometry.pixel_m for n in values.shape]
    stated = f"{size[0]:.3g} x {size[1]:.3g} m for {values.shape[0]} x {values.shape[1]} pixels"
    if min(size) < 0.3:
        expected = f"0.3 m or more each way for robots, not {stated}"
        raise WorldError("environment.geometry.pixel_m", geometry.pixel_m, expected)
    if np.prod(np.array(size) / min(geometry.pixel_m, WIDEST_CELL_M) + 1) > MOST_NODES:
        raise WorldError("environment.geometry.pixel_m", geometry.pixel_m, f"at most 100 x 100 m, not {stated}")
    ground = height_field(values, geometry.pixel_m, geometry.full_scale_m, geometry.base_m)
    ground.heights_m.flags.writeable = False
    start, formation = geometry.start, FORMATIONS[0]
    if start is None:
        start, formation = sited(ground, team, "environment.geometry.pixel_m", geometry.pixel_m)
    starts, dock = formation_poses(team, start, formation)
    return World(Path(geometry.path).stem, ground, None, (), starts, dock, geometry.goal)
