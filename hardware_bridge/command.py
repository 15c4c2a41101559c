"""What one robot is told: as wanted (`RobotCommand`), and as the supervisor lets it pass (`SafeCommand`)."""

from __future__ import annotations

from dataclasses import dataclass

from coop_envs.errors import CoopError


@dataclass(frozen=True)
class RobotCommand:
    """Set-points of one robot for one tick; the default stands still, dark.

    Wheel speeds (left, right) in rad/s, LED brightness and laser duty in 0..1, relative counts of the mirror (left,
    up).
    """

    wheels_rad_s: tuple[float, float] = (0.0, 0.0)
    brightness: float = 0.0
    laser: float = 0.0
    galvo: tuple[int, int] = (0, 0)

    @property
    def stands(self) -> bool:
        """Whether it tells the robot to stand still."""
        return self.wheels_rad_s == (0.0, 0.0)


class Seal:
    """What a supervisor holds; without one nobody makes a `SafeCommand`."""


_SEAL = Seal()


@dataclass(frozen=True)
class SafeCommand:
    """A command that a supervisor let pass; links send nothing else.

    Raises:
        CoopError: made by anyone but a supervisor.
    """

    command: RobotCommand
    seal: Seal

    def __post_init__(self) -> None:
        if self.seal is not _SEAL:
            raise CoopError("command: got one that no supervisor has passed, expected a supervisor's output")


def supervisors_seal() -> Seal:
    """The seal; only `hardware_bridge.safety` may ask for it (a test holds this)."""
    return _SEAL


def checked_safe(command: object) -> RobotCommand:
    """What a link may send.

    Raises:
        CoopError: it is not a supervisor's output.
    """
    if not isinstance(command, SafeCommand):
        raise CoopError(f"command: got {type(command).__name__}, expected a supervisor's output (SafeCommand)")
    return command.command
