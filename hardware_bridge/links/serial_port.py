"""A serial port that never waits to be written to, and knows when it is gone."""

from __future__ import annotations

import contextlib
import errno
import os
import select
from typing import Any

from hardware_bridge.link import LinkError

READ_BYTES = 4096


class SerialPort:
    """A port, open at a baud rate and kept from others; pyserial sets it up, and the rest is done on its descriptor.

    A robot that takes nothing in fills the port's queue: what finds no room is dropped and counted in ``refused``, so
    that no writer waits.

    Raises:
        LinkError: pyserial is not installed, the port is absent, in use or not a serial port.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path, self.refused = path, 0
        self._port: Any = _opened(path, baud)
        self._fd: int = self._port.fileno()
        os.set_blocking(self._fd, False)

    def read(self, timeout_s: float) -> bytes:
        """What has come, or what comes first within the time; nothing if nothing does.

        Raises:
            LinkError: the port is gone.
        """
        try:
            if not select.select([self._fd], [], [], max(timeout_s, 0.0))[0]:
                return b""
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise self._gone(error) from None
        if not data:
            raise self._gone("end of file")
        return data

    def write(self, data: bytes, urgent: bool = False) -> bool:
        """Put ``data`` into the queue, if ``urgent`` in place of all that waits there; whether all of it found room.

        Raises:
            LinkError: the port is gone.
        """
        try:
            if urgent:
                self._drop_waiting()
            written = os.write(self._fd, data)
        except BlockingIOError:
            written = 0
        except (OSError, ValueError) as error:
            raise self._gone(error) from None
        self.refused += len(data) - written
        return written == len(data)

    def close(self) -> None:
        """Let go of the port; never raises."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            with contextlib.suppress(Exception):
                self._port.close()

    def _drop_waiting(self) -> None:
        import termios

        with contextlib.suppress(termios.error):
            termios.tcflush(self._fd, termios.TCOFLUSH)

    def _gone(self, why: object) -> LinkError:
        return LinkError(f"{self.path}: got {why}, expected a serial port that stays plugged in")


def _opened(path: str, baud: int) -> Any:
    try:
        import serial
    except ImportError:
        raise LinkError("serial: got no pyserial, expected it: pip install 'coop_envs[serial]'") from None
    try:
        return serial.Serial(path, baud, exclusive=True, timeout=0, write_timeout=0)
    except (OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        why = errno.errorcode.get(number, "") if number else ""
        reason = {"ENOENT": "no such port", "EACCES": "no permission", "EAGAIN": "a port in use"}.get(why)
        told = reason or " ".join(str(error).split())
        raise LinkError(f"{path}: got {told}, expected a serial port that is free") from None
