"""What a network reads of the map window (n, 3, 16, 16), whose values are scaled to [-1, 1] here."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from coop_envs.observations import MAP_LAYERS, WINDOW

PROBED_LAYERS = 2  # ground and obstacle; robots come as mates
PROBE_DIRECTIONS = 8
PROBE_RADII = (1.0, 2.5, 4.5, 7.0)  # in cells of the window
PROBES = PROBED_LAYERS * PROBE_DIRECTIONS * len(PROBE_RADII)
POOLED = len(MAP_LAYERS) * 16


def scaled(window: Tensor) -> Tensor:
    """A window of 0 to 255, integer or float, as float32 in [-1, 1]."""
    return window.float() * (2.0 / 255.0) - 1.0


class MapEncoder(nn.Module):
    """Two strided convolutions and a dense layer: (n, 3, 16, 16) to (n, width)."""

    def __init__(self, channels: tuple[int, int], width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(len(MAP_LAYERS), channels[0], kernel_size=4, stride=2, padding=1)
        self.second = nn.Conv2d(channels[0], channels[1], kernel_size=3, stride=2, padding=1)
        self.dense = nn.Linear(channels[1] * (WINDOW // 4) ** 2, width)

    def forward(self, window: Tensor) -> Tensor:
        hidden = functional.relu(self.second(functional.relu(self.first(window))))
        return functional.relu(self.dense(hidden.flatten(1)))


def pooled(window: Tensor) -> Tensor:
    """Means over blocks of 4 x 4 cells (n, 48)."""
    return functional.avg_pool2d(window, WINDOW // 4).flatten(1)


class BodyProbes(nn.Module):
    """The map around the robot in the axes of its body: ground and obstacle at 8 directions and 4 distances (n, 64).

    The window does not turn with the robot, so that a small network would have to learn to rotate it before it could
    tell what lies ahead. The robot stands in cell (8, 8), whose centre is taken for its place.
    """

    offsets: Tensor

    def __init__(self) -> None:
        super().__init__()
        angles = [2.0 * math.pi * k / PROBE_DIRECTIONS for k in range(PROBE_DIRECTIONS)]
        ring = torch.tensor([[r * math.cos(a), r * math.sin(a)] for r in PROBE_RADII for a in angles])
        self.register_buffer("offsets", ring, persistent=False)

    def forward(self, window: Tensor, cos_yaw: Tensor, sin_yaw: Tensor) -> Tensor:
        """Probes of windows (n, 3, 16, 16) by headings (n,), interpolated; beyond the edge its own value goes on."""
        ahead, left = self.offsets[:, 0], self.offsets[:, 1]
        x = ahead * cos_yaw[:, None] - left * sin_yaw[:, None]
        y = ahead * sin_yaw[:, None] + left * cos_yaw[:, None]
        half = WINDOW / 2
        grid = (torch.stack([y, x], dim=-1) + 0.5) / half  # grid_sample wants the last axis first, the edges at +-1
        values = functional.grid_sample(
            window[:, :PROBED_LAYERS], grid[:, :, None], padding_mode="border", align_corners=False
        )
        return values.flatten(1)
