"""Samples from a Zumy's ROS messages, which come apart, each over a connection of its own.

The node sends a round of messages a loop: IMU, two encoders, two speeds. A round is one sample, given once its last
message is there; where the next IMU message comes first, with the latest of the others. Int32 encoders are unwrapped.
"""

from __future__ import annotations

import math
import threading

from hardware_bridge.link import Now
from hardware_bridge.protocols.zumy_packets import RAD_PER_TICK
from hardware_bridge.reading import Sample, Triple

LIMIT = 1000
"""Samples that wait to be read; older ones go first."""
WRAP = 2**32

_Key = tuple[str, int]
ROUND: frozenset[_Key] = frozenset({("imu", 0), ("encoder", 0), ("encoder", 1), ("speed", 0), ("speed", 1)})


class Reports:
    """Takes messages from any thread.

    ``count`` is how many samples there were, ``garbage`` how many messages were dropped because they held no finite
    numbers, ``unpaired`` how many samples were given before their round was whole.
    """

    def __init__(self, now: Now) -> None:
        self.count = self.garbage = self.unpaired = 0
        self._now, self._lock = now, threading.Lock()
        self._fresh: set[_Key] = set()
        self._values: dict[_Key, float] = {}
        self._imu: tuple[float, float | None, Triple, Triple] | None = None
        self._voltage_v: float | None = None
        self._samples: list[Sample] = []

    def imu(self, device_s: float | None, gyro_rad_s: Triple, accel_m_s2: Triple) -> None:
        """An IMU message; it starts a sample, stamped now."""
        with self._lock:
            if not all(math.isfinite(x) for x in (*gyro_rad_s, *accel_m_s2)):
                self.garbage += 1
                return
            if ("imu", 0) in self._fresh:
                self.unpaired += 1
                self._give()
            self._imu = (self._now(), device_s, gyro_rad_s, accel_m_s2)
            self._note(("imu", 0))

    def encoder(self, side: int, ticks: int) -> None:
        """Ticks of the left (0) or right (1) wheel, 32 bits that wrap."""
        with self._lock:
            total = self._values.get(("encoder", side), float(ticks))
            self._values["encoder", side] = total + (ticks - total + WRAP // 2) % WRAP - WRAP // 2
            self._note(("encoder", side))

    def speed(self, side: int, rad_s: float) -> None:
        """Speed of the left (0) or right (1) wheel."""
        with self._lock:
            if not math.isfinite(rad_s):
                self.garbage += 1
                return
            self._values["speed", side] = rad_s
            self._note(("speed", side))

    def voltage(self, volts: float) -> None:
        """The battery's voltage; it belongs to every sample until the next."""
        with self._lock:
            if math.isfinite(volts):
                self._voltage_v = volts
            else:
                self.garbage += 1

    def take(self) -> list[Sample]:
        """Every sample since the last call, oldest first."""
        with self._lock:
            samples, self._samples = self._samples, []
        return samples

    def clear(self) -> None:
        """Forget what waits; the next message begins a new round."""
        with self._lock:
            self._samples, self._imu = [], None
            self._fresh.clear()

    def _note(self, key: _Key) -> None:
        self._fresh.add(key)
        if self._fresh >= ROUND:
            self._give()

    def _give(self) -> None:
        """The sample of this round, if ever there was a message of each kind."""
        values, imu = self._values, self._imu
        self._fresh.clear()
        if imu is None or len(values) < len(ROUND) - 1:
            return
        left, right = (values["encoder", side] * RAD_PER_TICK for side in (0, 1))
        wheels = (values["speed", 0], values["speed", 1])
        host_s, device_s, gyro, accel = imu
        self._samples.append(Sample(host_s, device_s, (left, right), wheels, gyro, accel, self._voltage_v))
        del self._samples[:-LIMIT]
        self.count += 1
