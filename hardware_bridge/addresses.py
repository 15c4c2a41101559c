"""Where robots and cameras are reached, and that no two of a team are reached at one place."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from coop_envs.errors import require
from hardware_bridge.cameras.opencv_camera import OpencvCameraSettings
from hardware_bridge.cameras.ros1_camera import Ros1CameraSettings
from hardware_bridge.links.simulator_udp import SimulatorUdpSettings
from hardware_bridge.links.velociroach_xbee import VelociroachSettings
from hardware_bridge.links.zumy_ros1 import ZumyRos1Settings
from hardware_bridge.links.zumy_serial import ZumySerialSettings


def addresses_of(settings: object) -> tuple[str, ...]:
    """What nobody else may use; nothing where an emulation will say.

    A VelociRoACH has two: the port of its radio, which no other link can open, and its own address on the air.
    """
    match settings:
        case ZumySerialSettings(port=port):
            return _device(port)
        case VelociroachSettings(port=port, address=address):
            return (*_device(port), f"XBee {address:#06x}")
        case ZumyRos1Settings(master=master, namespace=namespace):
            return (f"{master.rstrip('/')} {namespace}",)
        case SimulatorUdpSettings(robot=int(robot)):
            return (f"{settings.host}:{settings.port} robot {robot}",)
        case OpencvCameraSettings(source=int(number)):
            return _device(f"/dev/video{number}")
        case OpencvCameraSettings(source=str(source)):
            return (source,) if "://" in source else _device(source)
        case Ros1CameraSettings(master=master, topic=topic):
            return (f"{master.rstrip('/')} {topic}",)
        case _:
            return ()


def check_addresses(parts: Iterable[tuple[str, str, object]]) -> None:
    """Refuse two parts at one address; each is (robot, ``link`` or ``camera``, settings).

    Raises:
        ConfigError: the second of them.
    """
    taken: dict[str, str] = {}
    for robot, part, settings in parts:
        for address in addresses_of(settings):
            other = taken.setdefault(address, f"{robot}'s {part}")
            free = other == f"{robot}'s {part}"
            require(free, f"robots.{robot}.{part}", address, f"another address than that of {other}")


def _device(path: str | None) -> tuple[str, ...]:
    """A device by the name that all its links lead to."""
    return () if path is None else (str(Path(path).resolve()),)
