"""From blobs of light to poses of hats on a robot's host: the project's solver, for one team."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import warp as wp

from coop_envs.agents.team import Team
from coop_envs.errors import require
from coop_envs.sensing.camera import CameraModel, camera_model
from coop_envs.sensing.features import allocate_features
from coop_envs.sensing.hats import pack_hats
from coop_envs.sensing.leds import LedModel
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.solver import allocate_workspace, solve_poses, solver_model
from coop_envs.validation import STRICT
from hardware_bridge.reading import CameraFrame

MAX_BLOBS = 64


@dataclass(frozen=True)
class Seeing:
    """How well cameras find LEDs: noise of a bright blob's centroid, how far its hue may be off, LEDs a pose takes."""

    __pydantic_config__ = STRICT
    pixel_noise_px: float = 0.5
    hue_tolerance_deg: float = 29.0
    min_leds: int = 4

    def __post_init__(self) -> None:
        require(0 < self.pixel_noise_px <= 10, "seeing.pixel_noise_px", self.pixel_noise_px, "above 0, at most 10 px")
        hue = self.hue_tolerance_deg
        require(0 < hue < 90, "seeing.hue_tolerance_deg", hue, "above 0, below 90 degrees")
        require(3 <= self.min_leds <= 8, "seeing.min_leds", self.min_leds, "3 to 8 LEDs")


class PoseFinder:
    """Writes the poses of all hats in all cameras' frames into ``measurements`` (one team)."""

    def __init__(self, team: Team, seeing: Seeing, measurements: Measurements, device: str) -> None:
        n = len(team.members)
        leds = LedModel()
        leds.noise_px, leds.hue_tolerance, leds.min_leds = (
            seeing.pixel_noise_px,
            seeing.hue_tolerance_deg,
            seeing.min_leds,
        )
        self._features = allocate_features(1, n, MAX_BLOBS, device)
        self._lit = wp.zeros((1, n), dtype=float, device=device)
        cameras = wp.array([camera_model(m.camera) for m in team.members], dtype=CameraModel, device=device)
        hats = pack_hats([m.hat.leds if m.hat else () for m in team.members], device)
        work = allocate_workspace(1, n, MAX_BLOBS, device)
        answer = wp.zeros((1, n, n), dtype=int, device=device)
        inputs = [self._features, cameras, hats, self._lit, measurements.docked, leds, solver_model(leds), work]
        running = wp.ones(1, dtype=int, device=device)
        self._solve = wp.launch(
            solve_poses, (1, n), inputs=[*inputs, measurements, answer, running], device=device, record_cmd=True
        )

    def find(self, frames: Sequence[CameraFrame | None], lit: Sequence[float]) -> None:
        """Look for every hat that is lit in every robot's frame; a frame's brightest blobs count if it has too many."""
        count, pixel = self._features.count.numpy()[0], self._features.pixel.numpy()[0]
        hue, signal = self._features.hue.numpy()[0], self._features.signal.numpy()[0]
        for i, frame in enumerate(frames):
            blobs = frame.blobs if frame else ()
            if len(blobs) > MAX_BLOBS:
                blobs = tuple(sorted(blobs, key=lambda blob: -blob[3])[:MAX_BLOBS])
            count[i] = len(blobs)
            for k, (u, v, hue_deg, strength) in enumerate(blobs):
                pixel[i, k], hue[i, k], signal[i, k] = (u, v), hue_deg, strength
        self._lit.numpy()[0] = lit
        self._solve.launch()
