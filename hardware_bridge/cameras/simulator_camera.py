"""The camera of a simulator's robot: it reports blobs, not images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from coop_envs.localization.clocks.alignment import ClockAlignment
from coop_envs.validation import STRICT
from hardware_bridge.link import Now
from hardware_bridge.protocols.datagrams import Datagram, numbers
from hardware_bridge.reading import CameraFrame, Triple
from hardware_bridge.simulator_client import SimulatorClient


@dataclass(frozen=True)
class SimulatorCameraSettings:
    """The camera of the simulator that the robot's emulation runs in."""

    __pydantic_config__ = STRICT
    kind: Literal["simulator"]


class SimulatorCamera:
    """A `FrameSource` over a line to the simulator of its own. ``garbage`` counts states that made no sense.

    Frames are stamped when they were taken, by the simulator's clock aligned with the host's.
    """

    def __init__(self, name: str, client: SimulatorClient, now: Now) -> None:
        self._name, self._client, self._now = name, client, now
        self._clock = ClockAlignment()
        self.garbage = 0

    @property
    def name(self) -> str:
        """The agent whose camera it is."""
        return self._name

    def connect(self) -> str:
        """Say hello. No frame is waited for: simulated time may stand still.

        Raises:
            LinkError: no simulator answers.
        """
        self._client.hello()
        host, port = self._client.address
        return f"simulator at {host}:{port}"

    def read(self) -> list[CameraFrame]:
        """Every frame since the last call, oldest first."""
        now_s, frames = self._now(), []
        for message in self._client.poll():
            if message["kind"] == "state" and message.get("blobs") is not None:
                frame = frame_of(message, self._taken_s(message, now_s))
                self.garbage += frame is None
                frames += [frame] if frame else []
        return frames

    def close(self) -> None:
        """Let go of the socket."""
        self._client.close()

    def _taken_s(self, state: Datagram, arrived_s: float) -> float:
        """When a frame was taken: ``stamp`` after the end of the tick at ``time_s``."""
        times = numbers([state.get("time_s"), state.get("stamp", 0.0)], 2)
        return arrived_s if times is None else self._clock.align(arrived_s, times[0]) + times[1]


def frame_of(state: Datagram, host_s: float) -> CameraFrame | None:
    """What a state says of the camera, None where that is nonsense."""
    rows: Any = state["blobs"]
    blobs = [numbers(row, 4) for row in rows] if isinstance(rows, list) else [None]
    spot = numbers(state["spot"], 3) if state.get("spot") is not None else ()
    if spot is None or None in blobs:
        return None
    seen = tuple((blob[0], blob[1], blob[2], blob[3]) for blob in blobs if blob)
    lit: Triple | None = (spot[0], spot[1], spot[2]) if spot else None
    return CameraFrame(host_s, seen, lit)
