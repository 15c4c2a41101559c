"""A serial port for emulated firmware: a pseudo-terminal, whose far end a host opens like a real port."""

from __future__ import annotations

import contextlib
import os
import tty
from pathlib import Path

READ_BYTES = 4096


class PtyPort:
    """The robot's end of a pseudo-terminal in raw mode; hosts may come and go.

    ``link``, if given, is a symbolic link to the host's end, so that its name stays when it is plugged in again.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._link, self._master, self._slave, self.path = link, -1, -1, ""
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether a host can reach it."""
        return self._master >= 0

    @property
    def address(self) -> str:
        """Where a host finds it."""
        return str(self._link) if self._link else self.path

    def fileno(self) -> int:
        """The robot's end, for `select`; only while plugged."""
        return self._master

    def plug(self) -> None:
        """Make a new pseudo-terminal, unless there is one."""
        if self.plugged:
            return
        self._master, self._slave = os.openpty()  # ours stays open too: without it the last host to leave hangs up
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        if self._link:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.path)

    def unplug(self) -> None:
        """Take the port away under whoever holds it: the host's end hangs up."""
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1
        if self._link:
            with contextlib.suppress(OSError):
                self._link.unlink()

    def read(self) -> bytes:
        """What the host has written; nothing if nothing."""
        try:
            return os.read(self._master, READ_BYTES) if self.plugged else b""
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Say something; what finds no room because no host reads is lost, as on a wire."""
        if self.plugged and data:
            with contextlib.suppress(OSError):
                os.write(self._master, data)
