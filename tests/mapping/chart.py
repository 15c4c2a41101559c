"""One team's ground map on the bench: footprints entered by hand."""

from __future__ import annotations

import numpy as np
import warp as wp

from coop_envs.mapping.ground_map import Footprint, GroundMap, MapModel, allocate_map, begin_map, draw_footprint

NX, NY, CELL, MARK = 24, 20, 0.05, 0.10
CONTACT, BODY = 0.10, 0.14
CORNER = (-0.4, -0.5)


@wp.kernel
def enter(ground: GroundMap, model: MapModel, r: int, foot: Footprint):
    ground.change_count[0] = 0
    draw_footprint(ground, model, 0, r, foot)


class Chart:
    """A map of 24 x 20 cells of 5 cm with two robots."""

    def __init__(self) -> None:
        self.model = MapModel()
        self.model.stride = 1
        self.model.nx, self.model.ny, self.model.cell, self.model.mark_radius = NX, NY, CELL, MARK
        self.map: GroundMap = allocate_map(1, 2, self.model, MARK + max(BODY, MARK), "cpu")
        self.begin([], 0.0)

    def begin(self, starts: list[tuple[float, float]], known_m: float) -> None:
        """Start anew, with ground known around some starts."""
        corner = wp.array([CORNER], dtype=wp.vec2, device="cpu")
        poses = wp.array(
            [[(*start, 0.0) for start in [*starts, (9.0, 9.0), (9.0, 9.0)][:2]]], dtype=wp.vec3, device="cpu"
        )
        cells = wp.array([(NX, NY)], dtype=wp.vec2i, device="cpu")
        chosen = wp.ones(1, dtype=int, device="cpu")
        wp.launch(begin_map, 1, inputs=[self.map, self.model, corner, cells, poses, known_m, chosen], device="cpu")

    def enter(self, x: float, y: float, sigma: float = 0.0, proves: bool = True, marks: int = 0, r: int = 0) -> None:
        foot = Footprint()
        foot.x, foot.y, foot.sigma = x, y, sigma
        foot.contact_radius, foot.body_radius = CONTACT, BODY
        foot.proves, foot.marks = int(proves), marks
        wp.launch(enter, 1, inputs=[self.map, self.model, r, foot], device="cpu")

    def drive(self, start: tuple[float, float], end: tuple[float, float], sigma: float = 0.0, r: int = 0) -> None:
        """Pass along a line in steps of 4 cm, as a decision at 0.2 m/s."""
        steps = max(1, round(float(np.hypot(end[0] - start[0], end[1] - start[1])) / 0.04))
        for t in np.linspace(0.0, 1.0, steps + 1):
            x, y = (1 - t) * np.array(start) + t * np.array(end)
            self.enter(float(x), float(y), sigma, r=r)

    def layer(self, k: int) -> np.ndarray:
        """Log-odds (nx, ny) in sixteenths."""
        return self.map.log_odds.numpy()[0, k].reshape(NX, NY).astype(int)

    @property
    def ground(self) -> np.ndarray:
        return self.layer(0)

    @property
    def obstacle(self) -> np.ndarray:
        return self.layer(1)

    def changes(self) -> np.ndarray:
        return changes_of(self.map)


def changes_of(ground: GroundMap) -> np.ndarray:
    """Layer, cell, old and new value (k, 4) of what was entered last into a team's map."""
    cell, packed = ground.changes.numpy()[0, : ground.change_count.numpy()[0]].T
    return np.stack([packed >> 16, cell, (packed >> 8 & 255) - 128, (packed & 255) - 128], axis=1)


def centres() -> tuple[np.ndarray, np.ndarray]:
    """x and y of all cell centres, (nx, ny) each."""
    i, j = np.meshgrid(np.arange(NX), np.arange(NY), indexing="ij")
    return CORNER[0] + (i + 0.5) * CELL, CORNER[1] + (j + 0.5) * CELL
