"""Keys from a terminal, one by one as they are pressed.

A key is the character typed, or one of ``up down left right tab backtab enter escape backspace suspend quit hangup``.
What a terminal sends for other keys is left out. Terminals tell of presses and repeats, never of releases.

A robot's set-points outlive a process that is suspended or killed, so Ctrl-Z and Ctrl-backslash are keys here
(``suspend``, ``quit``) and not the end of all commands; Ctrl-C stays an interrupt. ``hangup`` comes once, when the
terminal is gone.

Sources: ECMA-48 section 5.4 (control sequences), xterm's "ctlseqs" (cursor keys in both modes), POSIX termios.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, Self

from coop_envs.errors import ConfigError

ESCAPE = 0x1B
NAMED = {0x09: "tab", 0x0D: "enter", 0x0A: "enter", ESCAPE: "escape", 0x08: "backspace", 0x7F: "backspace"}
NAMED |= {0x1A: "suspend", 0x1C: "quit"}
FINALS = {"A": "up", "B": "down", "C": "right", "D": "left", "Z": "backtab"}
LONGEST_SEQUENCE = 16
CHUNK, MOST_CHUNKS = 4096, 4
INPUT_MODES, LOCAL_MODES, SPECIAL = 0, 3, 6
"""Places in what `termios.tcgetattr` returns."""


def decode_keys(pending: bytes, data: bytes) -> tuple[tuple[str, ...], bytes]:
    """Keys in ``pending + data``, and the bytes at the end that may begin another.

    A sequence may be split anywhere. A byte that cannot go on with one ends it and counts for itself, so that nothing
    swallows a space, say. Escape alone is known as such only from the next byte.
    """
    data, keys, at = pending + data, [], 0
    while at < len(data):
        length, key = _first_key(data[at:])
        if length == 0:
            break
        at += length
        if key:
            keys.append(key)
    return tuple(keys), data[at:]


def _first_key(data: bytes) -> tuple[int, str]:
    """Length and name of the first key, no name for what is no key of ours, no length for one that is not all there."""
    first = data[0]
    if first == ESCAPE and data[1:2] in (b"", b"[", b"O"):
        return _sequence(data)
    if first < 0x80:
        return 1, NAMED.get(first, chr(first) if first >= 0x20 else "")
    return _character(data)


def _sequence(data: bytes) -> tuple[int, str]:
    """A control sequence, ``ESC [ parameters final``, or an application cursor key, ``ESC O final``."""
    at = 2
    if data[1:2] == b"[":
        while at < len(data) and 0x30 <= data[at] <= 0x3F and at < LONGEST_SEQUENCE:
            at += 1
    if at >= len(data):
        return 0, ""
    if 0x40 <= data[at] <= 0x7E:
        return at + 1, FINALS.get(chr(data[at]), "")
    return at, ""


def _character(data: bytes) -> tuple[int, str]:
    """A character of several bytes of UTF-8; a byte that belongs to none is left out."""
    first = data[0]
    length = 2 if 0xC2 <= first <= 0xDF else 3 if 0xE0 <= first <= 0xEF else 4 if 0xF0 <= first <= 0xF4 else 1
    held = next((i for i in range(1, min(length, len(data))) if data[i] & 0xC0 != 0x80), None)
    if held is not None or length == 1:
        return held or 1, ""
    if len(data) < length:
        return 0, ""
    text = data[:length].decode(errors="ignore")
    return length, text if text.isprintable() else ""


class Keyboard:
    """The terminal on a file descriptor, in character mode while open; use as a context manager in the main thread.

    The terminal's modes are put back on exit, and for as long as a stop signal from elsewhere (``kill -TSTP``) suspends
    the process: ``before_suspend`` is called before that, to stop robots.

    Raises:
        ConfigError: on entry, where there is no terminal or it belongs to another job.
    """

    def __init__(self, fd: int | None = None, before_suspend: Callable[[], object] = lambda: None) -> None:
        self._fd, self._before_suspend = fd, before_suspend
        self._pending = b""
        self._gone = False

    def __enter__(self) -> Self:
        fd = _standard_input() if self._fd is None else self._fd
        if not os.isatty(fd):
            raise ConfigError("keyboard", "no terminal", "a terminal on standard input (ssh: with -t)")
        if _in_background(fd):
            raise ConfigError("keyboard", "a job in the background", "one in the foreground (fg)")
        self._open_fd = fd
        self._before: list[Any] = termios.tcgetattr(fd)
        self._handlers: dict[int, Any] = {}
        self._character_mode()
        if threading.current_thread() is threading.main_thread():
            self._handlers[signal.SIGTSTP] = signal.signal(signal.SIGTSTP, self._suspend)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._restore()

    def fileno(self) -> int:
        """The terminal's descriptor, for `select`."""
        return self._open_fd

    def read(self, timeout_s: float = 0.0) -> tuple[str, ...]:
        """Keys that have come, oldest first; waits for a first one for at most ``timeout_s``."""
        if self._gone or not select.select([self._open_fd], [], [], timeout_s)[0]:
            return ()
        keys: tuple[str, ...] = ()
        for _ in range(MOST_CHUNKS):
            if not select.select([self._open_fd], [], [], 0.0)[0]:
                break
            try:
                data = os.read(self._open_fd, CHUNK)
            except OSError:
                data = b""
            if not data:
                self._gone = True
                return (*keys, "hangup")
            more, self._pending = decode_keys(self._pending, data)
            keys += more
        return keys

    def _character_mode(self) -> None:
        """Keys at once and unseen. No key holds up our output (Ctrl-S), hides the next key (Ctrl-V), or stops us."""
        modes = [*self._before[:SPECIAL], list(self._before[SPECIAL])]
        modes[INPUT_MODES] &= ~termios.IXON
        modes[LOCAL_MODES] &= ~(termios.ICANON | termios.ECHO | termios.IEXTEN)
        nothing = os.fpathconf(self._open_fd, "PC_VDISABLE").to_bytes(1, "little")
        special = {termios.VMIN: 1, termios.VTIME: 0, termios.VSUSP: nothing, termios.VQUIT: nothing}
        for place, value in special.items():
            modes[SPECIAL][place] = value
        termios.tcsetattr(self._open_fd, termios.TCSADRAIN, modes)

    def _restore(self) -> None:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(self._open_fd, termios.TCSADRAIN, self._before)

    def _suspend(self, number: int, frame: FrameType | None) -> None:
        """Give the terminal back, stop as the signal asks, and take it again when the process goes on."""
        del frame
        self._before_suspend()
        self._restore()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, self._suspend)
        self._before = termios.tcgetattr(self._open_fd)
        self._character_mode()


def _standard_input() -> int:
    try:
        return sys.stdin.fileno()
    except (AttributeError, ValueError, OSError):
        raise ConfigError("keyboard", "no standard input", "a terminal on standard input (ssh: with -t)") from None


def _in_background(fd: int) -> bool:
    """Whether the terminal is ours but another job's turn; a terminal that controls nobody has no turns."""
    try:
        return os.tcgetpgrp(fd) != os.getpgrp()
    except OSError:
        return False
