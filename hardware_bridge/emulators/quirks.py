"""What goes wrong on a wire and in a robot: as settings of an emulated robot, and as faults while it runs."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass, field
from typing import Literal

from coop_envs.errors import require
from coop_envs.validation import STRICT

Fault = Literal["freeze", "silent", "garbage", "late", "unplug", "clock_jump", "heal"]


@dataclass(frozen=True)
class Quirks:
    """How badly bytes travel, and how the robot's clock runs.

    ``lost`` and ``garbled`` are the shares of pieces (what is written or read at once) that vanish or are damaged, each
    way; every piece takes ``delay_s`` and up to ``jitter_s`` more, in order. The clock starts at ``clock_start_us`` and
    is ``clock_drift_ppm`` fast. The same ``seed`` gives the same accidents to the same pieces.
    """

    __pydantic_config__ = STRICT
    lost: float = 0.0
    garbled: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    clock_start_us: int = 0
    clock_drift_ppm: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("lost", "garbled"):
            require(0 <= getattr(self, name) <= 1, f"quirks.{name}", getattr(self, name), "a share from 0 to 1")
        for name in ("delay_s", "jitter_s"):
            require(0 <= getattr(self, name) <= 60, f"quirks.{name}", getattr(self, name), "0 to 60 s")
        require(0 <= self.clock_start_us < 2**32, "quirks.clock_start_us", self.clock_start_us, "32 bits")
        require(abs(self.clock_drift_ppm) <= 1e5, "quirks.clock_drift_ppm", self.clock_drift_ppm, "within +/-1e5")

    def device_us(self, seconds: float, jumped_s: float = 0.0) -> int:
        """What the robot's clock of 32-bit microseconds says after so many true seconds."""
        elapsed = (seconds * (1 + self.clock_drift_ppm * 1e-6) + jumped_s) * 1e6
        return (self.clock_start_us + round(elapsed)) % 2**32


@dataclass(frozen=True)
class FaultCommand:
    """A fault to begin now; ``delay_s`` is for ``late``, ``jump_s`` for ``clock_jump``. ``heal`` ends all of them.

    ``freeze``: the robot hears nothing and says nothing, its set-points stay. ``silent``: it hears, and says nothing.
    ``garbage``: it says random bytes. ``late``: what it hears and says takes longer. ``unplug``: its port is gone.
    """

    __pydantic_config__ = STRICT
    fault: Fault
    delay_s: float = 0.5
    jump_s: float = 1000.0


@dataclass
class Wire:
    """One direction: pieces go in, and come out when their time has come, unless something happens to them."""

    quirks: Quirks
    chance: random.Random
    late_s: float = 0.0
    _under_way: deque[tuple[float, bytes]] = field(default_factory=deque)

    def put(self, piece: bytes, now_s: float) -> None:
        """A piece sets out."""
        if not piece or self.chance.random() < self.quirks.lost:
            return
        if self.chance.random() < self.quirks.garbled:
            piece = damaged(piece, self.chance)
        due_s = now_s + self.quirks.delay_s + self.late_s + self.chance.random() * self.quirks.jitter_s
        if self._under_way:
            due_s = max(due_s, self._under_way[-1][0])
        self._under_way.append((due_s, piece))

    def take(self, now_s: float) -> list[bytes]:
        """The pieces that have arrived."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= now_s:
            arrived.append(self._under_way.popleft()[1])
        return arrived

    def wait_s(self, now_s: float) -> float | None:
        """Time until the next piece arrives, None if nothing is under way."""
        return max(self._under_way[0][0] - now_s, 0.0) if self._under_way else None

    def clear(self) -> None:
        """What is under way is lost."""
        self._under_way.clear()


def damaged(piece: bytes, chance: random.Random) -> bytes:
    """The piece with a bit flipped, its end cut off, or random bytes put in."""
    at = chance.randrange(len(piece))
    match chance.randrange(3):
        case 0:
            return piece[:at] + bytes([piece[at] ^ 1 << chance.randrange(8)]) + piece[at + 1 :]
        case 1:
            return piece[:at]
        case _:
            return piece[:at] + chance.randbytes(chance.randint(1, 20)) + piece[at:]
