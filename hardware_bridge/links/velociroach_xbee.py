"""A VelociRoACH over its XBee radio: closed-loop leg speeds, in short timed runs that every `send` renews.

The robot has no other deadman: a run that is not renewed ends by itself after ``run_ms``. Each `send` carries a
velocity profile (see `roach_commands` for how speeds become counts) and a timed run; standing is a stop. A thread asks
for leg positions at ``poll_hz``; the radio carries no IMU, no clock and no voltage, and no command for LEDs or lasers.
One radio a robot: two links cannot share a port.
Source: `roach` [master] ``firmware/source/cmd.c``; `basestation` for the radio.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeVar

from coop_envs.agents.specification import Hat, RobotSpecification
from coop_envs.errors import require
from coop_envs.validation import STRICT
from hardware_bridge.command import RobotCommand, SafeCommand, checked_safe
from hardware_bridge.link import Identity, LinkError, Now
from hardware_bridge.links.serial_line import SerialLine
from hardware_bridge.links.serial_port import SerialPort
from hardware_bridge.protocols.roach_commands import (
    EXAMPLE_GAINS,
    MAX_STEP,
    RAD_PER_COUNT,
    STEPS,
    Kind,
    Payload,
    command_values,
    decode_payload,
    encode_command,
    encode_profile,
    positions_of,
    profile_speeds,
    version_of,
)
from hardware_bridge.protocols.xbee_frames import FrameParser, Received, Transmit, encode
from hardware_bridge.reading import Pair, Sample

ANSWER_S = 0.03
ASK_AGAIN_S = 0.2
SPEED_OVER_S = 0.1
Gains = tuple[int, int, int, int, int]
T = TypeVar("T")


@dataclass(frozen=True)
class VelociroachSettings:
    """The radio's port (None where an emulation will say), the robot's address, and what it may run.

    ``firmware`` lists beginnings of the versions that this link may drive: those whose 0x81 starts the motors. The
    default knows none, and the refusal tells what the robot calls itself. ``hat_brightness`` is that of LEDs that the
    robot carries always lit, 0 without. Gains are (Kp, Ki, Kd, Kaw, Kff). Baud: 57600 with an XBee, 230400 with the
    custom base station.
    """

    __pydantic_config__ = STRICT
    kind: Literal["velociroach_xbee"] = "velociroach_xbee"
    port: str | None = None
    baud: int = 57600
    address: int = 0x2052
    firmware: tuple[str, ...] = ()
    gains_left: Gains = EXAMPLE_GAINS
    gains_right: Gains = EXAMPLE_GAINS
    period_ms: int = 100
    run_ms: int = 300
    poll_hz: float = 50.0
    connect_s: float = 3.0
    hat_brightness: float = 0.0

    def __post_init__(self) -> None:
        require(self.port != "", "link.port", self.port, "a serial port such as /dev/ttyUSB0")
        require(self.baud > 0, "link.baud", self.baud, "a baud rate")
        require(0 <= self.address <= 0xFFFF, "link.address", self.address, "16 bits")
        require(all(self.firmware), "link.firmware", self.firmware, "beginnings of versions, none of them empty")
        for name in ("gains_left", "gains_right"):
            gains = getattr(self, name)
            fits = all(-(2**15) <= gain < 2**15 for gain in gains) and any(gains)
            require(fits, f"link.{name}", gains, "five numbers of 16 bits, not all 0")
        require(20 <= self.period_ms <= 1000, "link.period_ms", self.period_ms, "20 to 1000 ms")
        require(100 <= self.run_ms <= 1000, "link.run_ms", self.run_ms, "100 to 1000 ms")
        require(1 <= self.poll_hz <= 200, "link.poll_hz", self.poll_hz, "1 to 200 Hz")
        require(0 < self.connect_s <= 60, "link.connect_s", self.connect_s, "above 0, at most 60 s")
        require(0 <= self.hat_brightness <= 1, "link.hat_brightness", self.hat_brightness, "a brightness from 0 to 1")


class VelociroachXbeeLink:
    """A `RobotLink` to one VelociRoACH; ``polls`` and ``answers`` count questions for positions and what came back."""

    def __init__(
        self, name: str, robot: RobotSpecification, hat: Hat | None, settings: VelociroachSettings, now: Now
    ) -> None:
        self._name, self._settings, self._now = name, settings, now
        fastest = MAX_STEP * STEPS * RAD_PER_COUNT / (settings.period_ms * 1e-3)
        self._max_rad_s = min(robot.max_speed_m_s / robot.wheel_radius_m, fastest)
        self._shines = settings.hat_brightness if hat else 0.0
        self.polls = self.answers = 0
        self._line = SerialLine(name)
        self._forget()

    def _forget(self) -> None:
        """Begin as after switch-on of the robot."""
        self._parser, self._legs = FrameParser(), LegTrack()
        self._asked_at, self._waiting_since = -math.inf, -math.inf
        self._waits = False

    @property
    def name(self) -> str:
        """The agent's name."""
        return self._name

    @property
    def dropped(self) -> int:
        """Bytes that came and were in no frame."""
        return self._parser.dropped

    def connect(self) -> Identity:
        """Open the port, ask for the version and refuse one that is not known, set gains, and begin to poll.

        Raises:
            LinkError: no such port, nobody there, firmware that is not known, or gains that do not come back.
        """
        settings = self._settings
        if settings.port is None:
            raise LinkError(f"{self._name}.link.port: got None, expected a serial port such as /dev/ttyUSB0")
        self.close()
        self._forget()
        port = SerialPort(settings.port, settings.baud)
        try:
            version = self._greet(port)
        except LinkError:
            port.close()
            raise
        self._line.open(port)
        self.stop()
        self._line.serve(self._step)
        return Identity("velociroach", version, f"{settings.port} {settings.address:#06x}")

    def read(self) -> list[Sample]:
        """Everything that arrived since the last call, oldest first.

        Raises:
            LinkError: the port is gone, and all that came before has been read.
        """
        return self._line.read()

    def send(self, command: SafeCommand) -> RobotCommand:
        """Send, and return what the robot will do: legs' speeds in whole counts, no LED or laser that it obeys.

        Raises:
            LinkError: the port is gone, or was never opened.
            CoopError: the command did not come from a supervisor.
        """
        speeds = self._clipped(checked_safe(command).wheels_rad_s)
        profile = encode_profile(speeds, self._settings.period_ms)
        sent = profile_speeds(command_values(Payload(profile[1], profile[2:])) or (0,) * 12)
        with self._line.lock:
            if any(sent):
                orders = self._frame(profile) + self._frame(encode_command(Kind.TIMED_RUN, self._settings.run_ms))
            else:
                orders = self._frame(encode_command(Kind.STOP))
            self._line.put(orders + (b"" if self._waits else self._poll()))
        return RobotCommand(sent, brightness=self._shines)

    def stop(self) -> None:
        """Tell the robot to stand, twice over a radio that loses frames, in place of all that waits; never raises."""
        with self._line.lock:
            self._line.put_urgent(self._frame(encode_command(Kind.STOP)) * 2)

    def close(self) -> None:
        """Stop, and let go of the port; never raises."""
        self.stop()
        self._line.close()

    def _greet(self, port: SerialPort) -> str:
        """The robot's version, once it is known to be one that may be driven and its gains are set."""
        settings = self._settings
        where = f"{self._name}: {settings.port} {settings.address:#06x}"
        version = self._ask_for(port, encode_command(Kind.WHO_AM_I), version_of)
        if version is None:
            what = f"no answer within {settings.connect_s:g} s, expected a VelociRoACH at {settings.baud} baud"
            raise LinkError(f"{where}: got {what}")
        if not version.startswith(settings.firmware or ("\0",)):
            known = ", ".join(repr(text) for text in settings.firmware) or "none is listed in link.firmware"
            raise LinkError(f"{where}: got firmware {version!r}, expected one that is known: {known}")
        gains = encode_command(Kind.PID_GAINS, *settings.gains_left, *settings.gains_right)
        if self._ask_for(port, gains, lambda answer: answer.data == gains[2:] or None) is None:
            raise LinkError(f"{where}: got no echo of the gains, expected them as they were sent")
        return version

    def _ask_for(self, port: SerialPort, question: bytes, take: Callable[[Payload], T | None]) -> T | None:
        """What ``take`` makes of the robot's answer of the question's type, None if none comes in time."""
        end = time.monotonic() + self._settings.connect_s
        while time.monotonic() < end:
            port.write(self._frame(question))
            again = time.monotonic() + ASK_AGAIN_S
            while time.monotonic() < again:
                for payload in self._payloads(port.read(0.02)):
                    answer = take(payload) if payload.kind == question[1] else None
                    if answer is not None:
                        return answer
        return None

    def _payloads(self, data: bytes) -> list[Payload]:
        """What this robot says in ``data``."""
        frames = self._parser.feed(data)
        mine = (f for f in frames if isinstance(f, Received) and f.source == self._settings.address)
        return [payload for frame in mine if (payload := decode_payload(frame.data))]

    def _step(self, port: SerialPort) -> None:
        data = port.read(self._idle_s())
        arrived_s = self._now()
        for payload in self._payloads(data):
            self._take(payload, arrived_s)
        with self._line.lock:
            self._ask()

    def _idle_s(self) -> float:
        """How long nothing needs to be asked; capped, since the host's clock need not be the wall's."""
        return min(max(self._asked_at + 1.0 / self._settings.poll_hz - self._now(), 0.0), 0.01)

    def _ask(self) -> None:
        """Ask for positions if it is time and no answer is awaited, or if one did not come."""
        due = self._now() - self._asked_at >= 1.0 / self._settings.poll_hz
        late = time.monotonic() - self._waiting_since >= ANSWER_S
        if late if self._waits else due:
            self._line.put(self._poll())

    def _poll(self) -> bytes:
        now_s, period_s = self._now(), 1.0 / self._settings.poll_hz
        self.polls += 1
        self._waits, self._waiting_since = True, time.monotonic()
        self._asked_at = min(max(self._asked_at + period_s, now_s - period_s), now_s)
        return self._frame(encode_command(Kind.LEG_POSITIONS))

    def _take(self, payload: Payload, arrived_s: float) -> None:
        counts = positions_of(payload)
        if counts is None:
            return
        self.answers += 1
        self._waits = False
        angles = (counts[0] * RAD_PER_COUNT, counts[1] * RAD_PER_COUNT)
        self._line.samples.append(Sample(arrived_s, None, angles, self._legs.speeds(arrived_s, angles)))

    def _clipped(self, wheels_rad_s: Pair) -> Pair:
        if not all(math.isfinite(speed) for speed in wheels_rad_s):
            return 0.0, 0.0
        left, right = (min(max(speed, -self._max_rad_s), self._max_rad_s) for speed in wheels_rad_s)
        return left, right

    def _frame(self, data: bytes) -> bytes:
        return encode(Transmit(self._settings.address, data))


class LegTrack:
    """Speeds of legs from their positions over the last tenth of a second, as the radio carries no speeds."""

    def __init__(self) -> None:
        self._past: deque[tuple[float, Pair]] = deque()
        self._speeds: Pair = (0.0, 0.0)

    def speeds(self, at_s: float, angles_rad: Pair) -> Pair:
        """Mean speeds in rad/s up to now; the last ones where no time has passed."""
        past = self._past
        while len(past) > 1 and past[1][0] <= at_s - SPEED_OVER_S:
            past.popleft()
        if past and at_s <= past[-1][0]:
            return self._speeds
        past.append((at_s, angles_rad))
        if len(past) > 1:
            elapsed_s = at_s - past[0][0]
            left, right = ((now - then) / elapsed_s for now, then in zip(angles_rad, past[0][1], strict=True))
            self._speeds = (left, right)
        return self._speeds
