"""From a team file's settings to links and cameras."""

from __future__ import annotations

from coop_envs.agents.team import Member
from coop_envs.errors import ConfigError
from hardware_bridge.cameras.opencv_camera import OpencvCamera, OpencvCameraSettings
from hardware_bridge.cameras.ros1_camera import Ros1Camera, Ros1CameraSettings
from hardware_bridge.cameras.simulator_camera import SimulatorCamera, SimulatorCameraSettings
from hardware_bridge.cameras.source import FrameSource
from hardware_bridge.deployment import CameraSettings, Deployment, LinkSettings
from hardware_bridge.link import Now, RobotLink
from hardware_bridge.links.simulator_udp import SimulatorUdpLink, SimulatorUdpSettings
from hardware_bridge.links.velociroach_xbee import VelociroachSettings, VelociroachXbeeLink
from hardware_bridge.links.zumy_ros1 import ZumyRos1Link, ZumyRos1Settings
from hardware_bridge.links.zumy_serial import ZumySerialLink, ZumySerialSettings
from hardware_bridge.simulator_client import SimulatorClient

Address = tuple[str, int]


def make_link(member: Member, settings: LinkSettings, now: Now) -> RobotLink:
    """A link that is not connected yet."""
    name, robot, hat = member.name, member.robot, member.hat
    match settings:
        case ZumySerialSettings():
            return ZumySerialLink(name, robot, hat, settings, now)
        case ZumyRos1Settings():
            return ZumyRos1Link(name, robot, hat, settings, now)
        case VelociroachSettings():
            return VelociroachXbeeLink(name, robot, hat, settings, now)
        case SimulatorUdpSettings():
            return SimulatorUdpLink(name, robot, settings, now)


def make_camera(
    member: Member, robot: int, settings: CameraSettings, simulator: Address | None, now: Now
) -> FrameSource:
    """A camera that is not open yet; ``simulator`` is where an emulation listens."""
    assert member.camera is not None
    match settings:
        case OpencvCameraSettings():
            return OpencvCamera(member.name, member.camera, settings, now)
        case Ros1CameraSettings():
            return Ros1Camera(member.name, member.camera, settings, now)
        case SimulatorCameraSettings():
            if simulator is None:
                expected = "opencv or ros1: no simulator runs for it"
                raise ConfigError(f"robots.{member.name}.camera.kind", settings.kind, expected)
            return SimulatorCamera(member.name, SimulatorClient(simulator, robot), now)


def make_crew(
    deployment: Deployment, simulator: Address | None, now: Now
) -> tuple[dict[str, RobotLink], dict[str, FrameSource]]:
    """Links and cameras of the whole team, by agent name."""
    links: dict[str, RobotLink] = {}
    cameras: dict[str, FrameSource] = {}
    wired = [deployment.robots[member.name].link for member in deployment.team.members]
    served = ((link.host, link.port) for link in wired if isinstance(link, SimulatorUdpSettings))
    simulator = simulator or next(served, None)
    for i, member in enumerate(deployment.team.members):
        wiring = deployment.robots[member.name]
        links[member.name] = make_link(member, wiring.link, now)
        if wiring.camera is not None:
            cameras[member.name] = make_camera(member, i, wiring.camera, simulator, now)
    return links, cameras
