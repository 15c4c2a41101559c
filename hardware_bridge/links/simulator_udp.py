"""A robot of a simulator's process, over UDP."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any, Literal

from coop_envs.agents.specification import RobotSpecification
from coop_envs.errors import require
from coop_envs.validation import STRICT
from hardware_bridge.command import RobotCommand, SafeCommand, checked_safe
from hardware_bridge.link import Identity, Now
from hardware_bridge.protocols.datagrams import Datagram, numbers
from hardware_bridge.reading import Sample
from hardware_bridge.simulator_client import SimulatorClient


@dataclass(frozen=True)
class SimulatorUdpSettings:
    """Where the simulator listens, and which of its robots this is (its place in the team, from 0).

    In a team file with an ``emulation`` both follow from it.
    """

    __pydantic_config__ = STRICT
    kind: Literal["simulator"]
    host: str = "127.0.0.1"
    port: int = 0
    robot: int | None = None

    def __post_init__(self) -> None:
        require(0 <= self.port <= 65535, "link.port", self.port, "a UDP port, 1 to 65535")


class SimulatorUdpLink:
    """A `RobotLink` to one robot of a simulator."""

    def __init__(self, name: str, robot: RobotSpecification, settings: SimulatorUdpSettings, now: Now) -> None:
        self._name, self._settings, self._now = name, settings, now
        self._max_wheel_rad_s = robot.max_speed_m_s / robot.wheel_radius_m
        self._client: SimulatorClient | None = None
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        """The agent's name."""
        return self._name

    def connect(self) -> Identity:
        """Say hello."""
        settings = self._settings
        self._client = SimulatorClient((settings.host, settings.port), settings.robot)
        welcome = self._client.hello()
        self.stop()
        return Identity("simulator", str(welcome.get("name")), f"udp:{settings.host}:{settings.port}")

    def read(self) -> list[Sample]:
        """Every state that arrived and makes sense, as a sample."""
        messages = self._client.poll() if self._client else []
        samples = (_sample(message, self._now()) for message in messages if message["kind"] == "state")
        return [sample for sample in samples if sample is not None]

    def send(self, command: SafeCommand) -> RobotCommand:
        """Send all set-points, wheels clipped to what the robot can do."""
        wanted = checked_safe(command)
        limit = self._max_wheel_rad_s
        left, right = (min(max(speed, -limit), limit) for speed in wanted.wheels_rad_s)
        sent = RobotCommand((left, right), wanted.brightness, wanted.laser, wanted.galvo)
        with self._lock:
            if self._client:
                self._client.set(
                    wheels=list(sent.wheels_rad_s),
                    brightness=sent.brightness,
                    laser=sent.laser,
                    **({"galvo": list(sent.galvo)} if sent.galvo != (0, 0) else {}),
                )
        return sent

    def stop(self) -> None:
        """Zero wheels, laser off."""
        with self._lock:
            if self._client:
                self._client.set(wheels=[0.0, 0.0], laser=0.0)

    def close(self) -> None:
        """Stop and let go of the socket."""
        self.stop()
        with self._lock:
            if self._client:
                self._client.close()
                self._client = None


def _sample(message: Datagram, host_s: float) -> Sample | None:
    parts: dict[str, Any] = {
        "gyro": numbers(message.get("gyro"), 3),
        "accel": numbers(message.get("accel"), 3),
        "angles": numbers(message.get("angles"), 2),
        "wheels": numbers(message.get("wheels"), 2),
        "scalars": numbers([message.get("time_s"), message.get("voltage")], 2),
    }
    if message.get("powered") is not True or None in parts.values():
        return None
    device_s, voltage_v = parts["scalars"]
    return Sample(host_s, device_s, parts["angles"], parts["wheels"], parts["gyro"], parts["accel"], voltage_v)
