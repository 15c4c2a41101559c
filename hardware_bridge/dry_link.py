"""A link that listens and never tells the robot anything, for ``coop deploy --dry-run``."""

from __future__ import annotations

from hardware_bridge.command import RobotCommand, SafeCommand, checked_safe
from hardware_bridge.link import Identity, RobotLink
from hardware_bridge.reading import Sample


class DryLink:
    """Another link's ears. Connecting and closing tell the robot to stand, as every link does; nothing else is sent."""

    def __init__(self, link: RobotLink) -> None:
        self._link = link

    @property
    def name(self) -> str:
        """The agent's name."""
        return self._link.name

    def connect(self) -> Identity:
        """As the link."""
        return self._link.connect()

    def read(self) -> list[Sample]:
        """As the link."""
        return self._link.read()

    def send(self, command: SafeCommand) -> RobotCommand:
        """Nothing is sent: the robot goes on standing."""
        checked_safe(command)
        return RobotCommand()

    def stop(self) -> None:
        """As the link."""
        self._link.stop()

    def close(self) -> None:
        """As the link."""
        self._link.close()
