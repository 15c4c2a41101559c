"""The Zumy's ``set_laser_galvo`` service, called from a thread of its own so that no tick waits for it.

The newest laser level wins and is tried until it is taken. A mirror move is made once or not at all: ``dropped`` counts
those that a newer one replaced while they waited, that `LaserService.stop` cancelled, or whose call failed.
"""

from __future__ import annotations

import threading
import time
from typing import Any

from hardware_bridge import ros1

REQUEST = "float32 laser_cmd\nint16 galvo_cmd_0\nint16 galvo_cmd_1"
KIND = "ros_zumy/SetLaserGalvo"
AGAIN_S = 0.1
REST = (0, 0)


class LaserService:
    """Calls one robot's service. Levels are the service's own, 0..1, not duties."""

    def __init__(self, rospy: Any, path: str) -> None:
        self.dropped = self.failed = 0
        self._rospy, self._path = rospy, path
        self._kind = ros1.service_class(KIND, REQUEST)
        internal = rospy.exceptions.ROSInternalException  # what a transport raises when the other end is gone
        self._errors = (rospy.ServiceException, rospy.ROSException, internal, OSError)
        self._change = threading.Condition()
        self._level, self._move = 0.0, REST
        self._told: float | None = 0.0
        self._busy = self._closing = False
        threading.Thread(target=self._run, name=f"laser {path}", daemon=True).start()

    def want(self, level: float, move: tuple[int, int]) -> None:
        """Set the level, and make a move of the mirror unless it is (0, 0). Returns at once."""
        with self._change:
            if move != REST:
                self.dropped += self._move != REST
                self._move = move
            self._level = level
            self._change.notify_all()

    def stop(self) -> None:
        """Laser off, also where it was told to be before; a move that waits is cancelled."""
        with self._change:
            self.dropped += self._move != REST
            self._level, self._move, self._told = 0.0, REST, None
            self._change.notify_all()

    def settled(self, timeout_s: float) -> bool:
        """Whether everything wanted was done, in time."""
        end = time.monotonic() + timeout_s
        with self._change:
            return self._change.wait_for(lambda: not self._pending() and not self._busy, end - time.monotonic())

    def close(self) -> None:
        """End the thread; what is still wanted is tried once."""
        with self._change:
            self._closing = True
            self._change.notify_all()

    def _pending(self) -> bool:
        return self._level != self._told or self._move != REST

    def _run(self) -> None:
        proxy: Any = None
        failed = False
        while True:
            with self._change:
                self._busy = False
                self._change.notify_all()
                self._change.wait_for(lambda: self._closing or self._pending())
                if not self._pending() or (self._closing and failed):
                    break
                level, move = self._level, self._move
                self._told, self._move, self._busy = level, REST, True
            try:
                proxy = proxy or self._rospy.ServiceProxy(self._path, self._kind, persistent=True)
                proxy(level, *move)
                failed = False
            except self._errors:
                if proxy is not None:
                    proxy.close()
                proxy, failed = None, True
                self._note_failure(move)
        if proxy is not None:
            proxy.close()

    def _note_failure(self, move: tuple[int, int]) -> None:
        """A call failed; its level will be tried again, over a new connection."""
        with self._change:
            self.failed += 1
            self.dropped += move != REST
            self._told = None
            self._change.wait_for(lambda: self._closing, AGAIN_S)
