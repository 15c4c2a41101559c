"""`RobotLink`: the contract of everything that carries commands to one robot and its reports back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from coop_envs.errors import CoopError
from hardware_bridge.command import RobotCommand, SafeCommand
from hardware_bridge.reading import Sample

Now = Callable[[], float]
"""The host's clock: seconds, never back."""


class LinkError(CoopError):
    """A robot cannot be reached, or answers something that no robot of its kind would."""


@dataclass(frozen=True)
class Identity:
    """Who answered: kind of robot or firmware, version, and where."""

    kind: str
    version: str
    address: str


class RobotLink(Protocol):
    """One robot. Calls return at once, apart from `connect`; a link may be called from several threads.

    No robot stops by itself when messages stop: whoever opens a link keeps sending, or calls `stop`.
    """

    @property
    def name(self) -> str:
        """The agent's name."""
        ...

    def connect(self) -> Identity:
        """Open the port, ask who is there, and begin to read. The robot is told to stand.

        Raises:
            LinkError: nobody there, or not the robot that was expected.
        """
        ...

    def read(self) -> list[Sample]:
        """Everything that arrived since the last call, oldest first.

        Raises:
            LinkError: the port is gone. Garbage on the wire is dropped and counted, never raised.
        """
        ...

    def send(self, command: SafeCommand) -> RobotCommand:
        """Send, and return what was really sent after clipping and quantising.

        Raises:
            LinkError: the port is gone.
            CoopError: the command did not come from a supervisor.
        """
        ...

    def stop(self) -> None:
        """Tell the robot to stand, dark, laser off, now and before anything that waits; never raises."""
        ...

    def close(self) -> None:
        """Stop, and let go of the port; never raises."""
        ...
