"""A Zumy over its serial line: polled for its sensors, told its set-points.

A thread sends G at ``poll_hz`` and takes the S that comes for each; one that the robot does not answer, for want of a
fresh IMU sample, is asked again after 10 ms. `send` asks too where no answer is awaited, so that a poll waits whenever
a simulator in lock-step goes on. Set-points go out with every `send`: wheels each time, LEDs and laser when
they change and now and then, since the firmware queues only four packets, and every L with a count moves the mirror.
Source: `mbed_zumy` [packet]; `ros_zumy` [packet] ``packet_parser.py`` for the host's 10 ms.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from typing import Literal

from coop_envs.agents.specification import Hat, RobotSpecification
from coop_envs.errors import require
from coop_envs.localization.clocks.alignment import DeviceClock
from coop_envs.validation import STRICT
from hardware_bridge.command import RobotCommand, SafeCommand, checked_safe
from hardware_bridge.link import Identity, LinkError, Now
from hardware_bridge.links.serial_line import SerialLine
from hardware_bridge.links.serial_port import SerialPort
from hardware_bridge.links.zumy_set_points import colours, sendable
from hardware_bridge.protocols.zumy_packets import (
    BAUD,
    LEDS,
    RAD_PER_TICK,
    STANDARD_GRAVITY_M_S2,
    VOLTS_PER_READING,
    Packet,
    PacketParser,
    Sensors,
    encode_laser,
    encode_markers,
    encode_poll,
    encode_time,
    encode_wheels,
    sensors_of,
)
from hardware_bridge.reading import Sample

ANSWER_S = 0.01
MARKERS_AGAIN_S, LASER_AGAIN_S, TIME_AGAIN_S = 1.0, 0.3, 1.0
REST = (0, 0)


@dataclass(frozen=True)
class ZumySerialSettings:
    """Which port the robot hangs on (None where an emulation will say), and how often it is polled."""

    __pydantic_config__ = STRICT
    kind: Literal["zumy_serial"] = "zumy_serial"
    port: str | None = None
    baud: int = BAUD
    poll_hz: float = 100.0
    connect_s: float = 2.0

    def __post_init__(self) -> None:
        require(self.port != "", "link.port", self.port, "a serial port such as /dev/ttyUSB0")
        require(self.baud > 0, "link.baud", self.baud, "a baud rate")
        require(1 <= self.poll_hz <= 1000, "link.poll_hz", self.poll_hz, "1 to 1000 Hz")
        require(0 < self.connect_s <= 60, "link.connect_s", self.connect_s, "above 0, at most 60 s")


class ZumySerialLink:
    """A `RobotLink` to one Zumy.

    ``polls`` and ``answers`` count G and S; ``round_trips_s`` holds what T packets took, the newest last.

    Raises:
        ConfigError: the hat has more LEDs than the robot can light.
    """

    def __init__(
        self, name: str, robot: RobotSpecification, hat: Hat | None, settings: ZumySerialSettings, now: Now
    ) -> None:
        self._name, self._robot, self._settings, self._now = name, robot.name, settings, now
        self._hues = tuple(led.hue_deg for led in hat.leds) if hat else ()
        require(len(self._hues) <= LEDS, f"{name}.hat.leds", len(self._hues), f"at most {LEDS} LEDs")
        self.polls = self.answers = 0
        self.round_trips_s: deque[float] = deque(maxlen=100)
        self._line = SerialLine(name)
        self._forget()

    def _forget(self) -> None:
        """Begin as after switch-on of the robot."""
        self._parser, self._clock = PacketParser(), DeviceClock()
        self._sequence = 0
        self._waiting_since: float | None = None
        self._asked_at = self._timed_at = self._markers_at = self._laser_at = -math.inf
        self._time_asked: float | None = None
        self._shown, self._laser = -1.0, -1.0

    @property
    def name(self) -> str:
        """The agent's name."""
        return self._name

    @property
    def dropped(self) -> int:
        """Bytes that came and were in no packet."""
        return self._parser.dropped

    def connect(self) -> Identity:
        """Open the port, ask for the robot's time, tell the robot to stand, and begin to poll.

        Raises:
            LinkError: no such port, or nobody there who answers as a Zumy does.
        """
        settings = self._settings
        if settings.port is None:
            raise LinkError(f"{self._name}.link.port: got None, expected a serial port such as /dev/ttyUSB0")
        self.close()
        self._forget()
        port = SerialPort(settings.port, settings.baud)
        if not self._answers(port):
            port.close()
            what = f"no answer within {settings.connect_s:g} s, expected a Zumy at {settings.baud} baud"
            raise LinkError(f"{self._name}: {settings.port}: got {what}")
        self._line.open(port)
        self.stop()
        self._line.serve(self._step)
        return Identity("zumy", "mbed_zumy [packet]", settings.port)

    def read(self) -> list[Sample]:
        """Everything that arrived since the last call, oldest first.

        Raises:
            LinkError: the port is gone, and all that came before has been read.
        """
        return self._line.read()

    def send(self, command: SafeCommand) -> RobotCommand:
        """Send, and return what the robot will do after clipping and quantising.

        Raises:
            LinkError: the port is gone, or was never opened.
            CoopError: the command did not come from a supervisor.
        """
        sent, level = sendable(checked_safe(command), bool(self._hues))
        with self._line.lock:
            packets = encode_wheels(*sent.wheels_rad_s, self._next()) + self._extras(sent, level)
            self._line.put(packets + (b"" if self._waiting_since is not None else self._poll()))
        return sent

    def stop(self) -> None:
        """Tell the robot to stand, laser off, in place of all that waits; never raises.

        Its LEDs stay as they are: others may be looking at them. Wheels are told twice, since the first packet may
        follow a torn one.
        """
        with self._line.lock:
            still, off = (encode_wheels(0.0, 0.0, self._next()), encode_laser(0.0, REST, self._next()))
            self._laser = -1.0
            self._line.put_urgent(still + off + still)

    def close(self) -> None:
        """Stop, and let go of the port; never raises."""
        self.stop()
        self._line.close()

    def _answers(self, port: SerialPort) -> bool:
        end = time.monotonic() + self._settings.connect_s
        while time.monotonic() < end:
            port.write(encode_time(sequence=self._next()))
            again = time.monotonic() + 0.1
            while time.monotonic() < again:
                if any(packet.kind == "T" for packet in self._parser.feed(port.read(0.02))):
                    return True
        return False

    def _extras(self, sent: RobotCommand, level: float) -> bytes:
        """M and L if they are due; one that only repeats the last waits for a turn of its own."""
        now_s, packets = self._now(), b""
        if sent.brightness != self._shown or now_s - self._markers_at >= MARKERS_AGAIN_S:
            packets += encode_markers(colours(self._hues, sent.brightness), self._next())
            self._shown, self._markers_at = sent.brightness, now_s
        again = not packets and now_s - self._laser_at >= LASER_AGAIN_S
        if sent.galvo != REST or sent.laser != self._laser or again:
            packets += encode_laser(level, sent.galvo, self._next())
            self._laser, self._laser_at = sent.laser, now_s
        return packets

    def _step(self, port: SerialPort) -> None:
        data = port.read(self._idle_s())
        arrived_s = self._now()
        for packet in self._parser.feed(data):
            self._take(packet, arrived_s)
        with self._line.lock:
            self._ask()

    def _idle_s(self) -> float:
        """How long nothing needs to be asked."""
        left_s = self._asked_at + 1.0 / self._settings.poll_hz - self._now()
        return min(max(left_s, 0.0), ANSWER_S)

    def _ask(self) -> None:
        """Ask for what is due: the time in a turn of its own, or the sensors."""
        now_s, since = self._now(), self._waiting_since
        late = since is not None and time.monotonic() - since >= ANSWER_S
        if now_s - self._asked_at < 1.0 / self._settings.poll_hz and not late:
            return
        if now_s - self._timed_at >= TIME_AGAIN_S:
            self._timed_at, self._time_asked = now_s, time.monotonic()
            self._line.put(encode_time(sequence=self._next()))
        else:
            self._line.put(self._poll())

    def _poll(self) -> bytes:
        self.polls += 1
        period_s, now_s = 1.0 / self._settings.poll_hz, self._now()
        self._asked_at = min(max(self._asked_at + period_s, now_s - period_s), now_s)
        self._waiting_since = time.monotonic()
        return encode_poll(self._next())

    def _take(self, packet: Packet, arrived_s: float) -> None:
        if packet.kind == "T" and self._time_asked is not None:
            self.round_trips_s.append(time.monotonic() - self._time_asked)
            self._time_asked = None
        sensors = sensors_of(packet)
        if sensors is not None:
            self.answers += 1
            self._waiting_since = None
            self._line.samples.append(_sample(sensors, arrived_s, self._clock.unwrap(arrived_s, sensors.time_us)))

    def _next(self) -> int:
        self._sequence += 1
        return self._sequence


def _sample(sensors: Sensors, host_s: float, device_s: float) -> Sample:
    gyro, accel = (math.radians(v) for v in sensors.gyro_deg_s), (v * STANDARD_GRAVITY_M_S2 for v in sensors.accel_g)
    (gx, gy, gz), (ax, ay, az), (left, right) = gyro, accel, sensors.encoders
    angles = (left * RAD_PER_TICK, right * RAD_PER_TICK)
    volts = sensors.voltage * VOLTS_PER_READING
    return Sample(host_s, device_s, angles, sensors.velocities_rad_s, (gx, gy, gz), (ax, ay, az), volts)
