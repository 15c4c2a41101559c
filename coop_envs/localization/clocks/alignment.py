"""When a sample was taken, on the host's clock, from when it arrived and what the robot's own clock said.

A robot's clock counts microseconds in 32 bits, so it wraps every 71.6 minutes; it starts anywhere, and runs fast or
slow by some tens of ppm. A sample arrives after it was taken, by a delay that varies but is never negative. So the
differences host - device lie above a straight line, and touch it where the delay was least: the line is found as the
edge of the lower convex hull of the least difference of each second. The least delay itself cannot be seen and counts
as none.

Source of the line: Moon, Skelly, Towsley, Estimation and Removal of Clock Skew, INFOCOM 1999, whose linear program the
hull's edge below the mean time solves.
"""

from __future__ import annotations

from collections import deque

WRAP_S = 2**32 * 1e-6
WINDOW_S, WINDOWS = 1.0, 30
SLOPE_AFTER_S, MAX_SLOPE = 5.0, 1.0e-3
JUMP_S, BACK_S, LATE_S = 0.1, 1.0e-3, 0.25

Point = tuple[float, float]


class DeviceClock:
    """Seconds of a clock of 32-bit microseconds, unwrapped: of the values that a reading can stand for, the nearest to
    what the host's clock lets expect. A clock that is set back or begins again goes back here, too.
    """

    def __init__(self) -> None:
        self._last: Point | None = None

    def unwrap(self, host_s: float, device_us: int) -> float:
        """The device's seconds at a reading that arrived at ``host_s``."""
        device_s = device_us * 1e-6
        if self._last is not None:
            expected = self._last[1] + (host_s - self._last[0])
            device_s += round((expected - device_s) / WRAP_S) * WRAP_S
        self._last = (host_s, device_s)
        return device_s


class ClockAlignment:
    """The line that takes device seconds to host seconds, learned from every sample.

    ``jumps`` counts how often the device's clock went back, or ahead further than any delay explains: it was started
    anew or set, and the line is learned anew. A sample that is late by more than 0.25 s teaches nothing.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._clock = DeviceClock()
        self._begin()

    def _begin(self) -> None:
        self._least: deque[Point] = deque(maxlen=WINDOWS)
        self._window_end_s = -float("inf")
        self._last_device_s = -float("inf")
        self._slope, self._offset_s, self._origin_s = 0.0, 0.0, 0.0

    def observe(self, host_s: float, device_us: int) -> tuple[float, float]:
        """Device seconds, unwrapped, and the host time at which a sample that arrived at ``host_s`` was taken."""
        device_s = self._clock.unwrap(host_s, device_us)
        return device_s, self.align(host_s, device_s)

    def align(self, host_s: float, device_s: float) -> float:
        """The host time at which a sample was taken, for device seconds that are unwrapped."""
        offset_s = host_s - device_s
        if self._jumped(device_s, offset_s):
            self.jumps += 1
            self._begin()
        self._last_device_s = device_s
        if not self._least or offset_s < self._line_s(device_s) + LATE_S:
            self._learn(device_s, offset_s)
        return min(host_s, device_s + self._line_s(device_s))

    def recall(self, host_s: float, device_s: float) -> float:
        """As `align`, for a sample that others have overtaken: nothing is learned from it."""
        return min(host_s, device_s + self._line_s(device_s))

    @property
    def drift_ppm(self) -> float:
        """How much faster than the host's clock the device's runs."""
        return -self._slope / (1.0 + self._slope) * 1e6

    def _jumped(self, device_s: float, offset_s: float) -> bool:
        if device_s < self._last_device_s - BACK_S:
            return True
        settled = len(self._least) > 1
        return settled and offset_s < self._line_s(device_s) - JUMP_S

    def _line_s(self, device_s: float) -> float:
        return self._offset_s + self._slope * (device_s - self._origin_s)

    def _learn(self, device_s: float, offset_s: float) -> None:
        fresh = device_s >= self._window_end_s
        if fresh:
            self._window_end_s = device_s + WINDOW_S
            self._least.append((device_s, offset_s))
        elif offset_s < self._least[-1][1]:
            self._least[-1] = (device_s, offset_s)
        else:
            return
        self._origin_s, self._offset_s, self._slope = _lower_line(list(self._least))


def _lower_line(points: list[Point]) -> tuple[float, float, float]:
    """Origin, value there and slope of the line below all points that comes nearest to them."""
    if points[-1][0] - points[0][0] < SLOPE_AFTER_S:
        at, least = min(points, key=lambda point: point[1])
        return at, least, 0.0
    hull: list[Point] = []
    for point in points:
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    mean = sum(at for at, _ in points) / len(points)
    edge = next(k for k in range(1, len(hull)) if hull[k][0] >= mean or k == len(hull) - 1)
    (x0, y0), (x1, y1) = hull[edge - 1], hull[edge]
    return x0, y0, max(-MAX_SLOPE, min(MAX_SLOPE, (y1 - y0) / (x1 - x0)))


def _turns_down(a: Point, b: Point, c: Point) -> bool:
    """Whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
