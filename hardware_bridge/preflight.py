"""Before anything moves: does every robot answer, stand, and make sense?"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from coop_envs.agents.specification import Battery
from coop_envs.errors import ConfigError
from hardware_bridge.battery import charge
from hardware_bridge.cameras.source import FrameSource
from hardware_bridge.clocks import MissionClock
from hardware_bridge.deployment import Deployment
from hardware_bridge.link import RobotLink
from hardware_bridge.reading import CameraFrame, Sample

LISTEN_S = 0.4
GRAVITY, GRAVITY_TOLERANCE = 9.81, 1.5
STILL_RAD_S, STILL_WHEEL_RAD_S = 0.2, 0.5
Say = Callable[[str], object]


def connect_all(links: Mapping[str, RobotLink], cameras: Mapping[str, FrameSource], say: Say) -> None:
    """Open every link and camera; on the first that fails, close all that are open and raise.

    Raises:
        LinkError: who is not there.
    """
    opened: list[RobotLink | FrameSource] = []
    try:
        for name, link in links.items():
            opened.append(link)
            identity = link.connect()
            say(f"{name}: {identity.kind} {identity.version} at {identity.address}")
        for name, camera in cameras.items():
            opened.append(camera)
            found = camera.connect()
            say(f"{name}: camera {found}")
    except BaseException:
        for part in opened:
            part.close()
        raise


def listen(
    deployment: Deployment,
    links: Mapping[str, RobotLink],
    cameras: Mapping[str, FrameSource],
    clock: MissionClock,
    send_rest: Callable[[], object],
) -> dict[str, list[CameraFrame]]:
    """Listen to the robots at rest for a moment, and refuse what makes no sense; what the cameras saw meanwhile.

    ``send_rest`` tells everybody to stand, every tick. Robots without an IMU on their radio are only asked to report.

    Raises:
        ConfigError: a robot that is silent, moves, lies on its side, or is short of charge.
    """
    frames: dict[str, list[CameraFrame]] = {name: [] for name in cameras}
    heard: dict[str, list[Sample]] = {name: [] for name in links}
    tick_s, due_s = deployment.rates.tick_s, clock.now_s()
    for _ in range(round(LISTEN_S / tick_s)):
        send_rest()
        due_s += tick_s
        clock.wait_until(due_s)
        for name, link in links.items():
            heard[name] += link.read()
        for name, camera in cameras.items():
            frames[name] += camera.read()
    for member in deployment.team.members:
        if member.reserve:
            continue
        floor = deployment.safety.battery_floor or 0.0
        for field, value, expected, good in _findings(heard[member.name], floor, member.robot.battery):
            if not good:
                raise ConfigError(f"robots.{member.name}.{field}", value, expected)
    return frames


def _findings(samples: list[Sample], floor: float, battery: Battery) -> list[tuple[str, object, str, bool]]:
    """What was looked at: field, value, what was expected, whether it is so."""
    found: list[tuple[str, object, str, bool]] = [("reports", len(samples), "reports while it rests", bool(samples))]
    if not samples:
        return found
    wheels = max(abs(speed) for sample in samples for speed in sample.wheels_rad_s)
    found.append(("wheels", round(wheels, 3), f"at rest, below {STILL_WHEEL_RAD_S} rad/s", wheels < STILL_WHEEL_RAD_S))
    gyros = [math.hypot(*sample.gyro_rad_s) for sample in samples if sample.gyro_rad_s]
    if gyros:
        rate = sorted(gyros)[len(gyros) // 2]
        found.append(("gyro", round(rate, 3), f"at rest, below {STILL_RAD_S} rad/s", rate < STILL_RAD_S))
    forces = [sample.accel_m_s2 for sample in samples if sample.accel_m_s2]
    if forces:
        size, up = math.hypot(*forces[-1]), forces[-1][2]
        fits = abs(size - GRAVITY) < GRAVITY_TOLERANCE and up > 0.7 * size
        expected = f"gravity, about {GRAVITY} m/s^2 upwards: is the IMU calibrated, the robot upright?"
        found.append(("accel", tuple(round(v, 2) for v in forces[-1]), expected, fits))
    voltage_v = samples[-1].voltage_v
    if voltage_v is not None:
        left = charge(battery, voltage_v)
        found.append(("battery", f"{voltage_v:.2f} V ({left:.0%})", f"more than {floor:.0%}", left > floor))
    return found
