"""`FrameSource`: the contract of everything that gives a robot's camera frames."""

from __future__ import annotations

from typing import Protocol

from hardware_bridge.reading import CameraFrame


class FrameSource(Protocol):
    """One camera. Calls return at once, apart from `connect`."""

    @property
    def name(self) -> str:
        """The agent whose camera it is."""
        ...

    def connect(self) -> str:
        """Open the camera and wait for a first frame; says what was found.

        Raises:
            LinkError: no camera, no frame, or frames of another size than the calibration's.
        """
        ...

    def read(self) -> list[CameraFrame]:
        """Every frame since the last call, oldest first.

        Raises:
            LinkError: the camera is gone.
        """
        ...

    def close(self) -> None:
        """Let go of the camera; never raises."""
        ...
