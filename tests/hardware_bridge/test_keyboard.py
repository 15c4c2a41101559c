"""Keys through a real pseudo-terminal: decoding, split reads, terminal modes, suspension and hangup."""

from __future__ import annotations

import contextlib
import itertools
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.errors import ConfigError
from hardware_bridge.keyboard import INPUT_MODES, LOCAL_MODES, Keyboard, decode_keys

ROOT = Path(__file__).parents[2]
SLACK_S = 20.0

TYPED = [
    (b"w", ("w",)),
    (b" ", (" ",)),
    (b"\x1b[A\x1b[B\x1b[C\x1b[D", ("up", "down", "right", "left")),
    (b"\x1bOA\x1bOB\x1bOC\x1bOD", ("up", "down", "right", "left")),
    (b"\x1b[1;5A", ("up",)),
    (b"\t\x1b[Z\r\n\x7f", ("tab", "backtab", "enter", "enter", "backspace")),
    (b"\x1b[3~\x1bOP\x1b[15~w", ("w",)),
    (b"\x1b\x1b[A", ("escape", "up")),
    (b"\x1bw", ("escape", "w")),
    (b"\x1b[ ", (" ",)),
    (b"\x1bO ", (" ",)),
    (b"\x1b[12 ", (" ",)),
    ("äw€".encode(), ("ä", "w", "€")),
    (b"\xe2 \xffw\xc3", (" ", "w")),
    (b"\x1a\x1c\x00\x07", ("suspend", "quit")),
]


@pytest.mark.parametrize(("data", "keys"), TYPED)
def test_keys_are_what_terminals_send(data: bytes, keys: tuple[str, ...]) -> None:
    assert decode_keys(b"", data)[0] == keys


@given(data=st.binary(max_size=40), cuts=st.lists(st.integers(0, 40), max_size=6))
def test_where_reads_are_split_changes_nothing(data: bytes, cuts: list[int]) -> None:
    keys: tuple[str, ...] = ()
    pending = b""
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    for begin, end in itertools.pairwise(edges):
        more, pending = decode_keys(pending, data[begin:end])
        keys += more
    assert (keys, pending) == decode_keys(b"", data)


pieces = st.sampled_from([b"\x1b", b"\x1b[", b"\x1b[1;", b"\x1bO", b"\xe2\x82", b"w", b"\xff", b"\x1b[A"])


@given(before=st.lists(pieces | st.binary(max_size=6), max_size=6))
def test_nothing_swallows_a_space(before: list[bytes]) -> None:
    """A space is the e-stop: whatever came before, it is told at once."""
    data = b"".join(before)
    keys, pending = decode_keys(b"", data + b" ")
    assert keys[-1] == " "
    assert pending == b""
    assert keys.count(" ") == data.count(b" ") + 1


@given(data=st.binary(max_size=200))
def test_what_waits_for_more_stays_short(data: bytes) -> None:
    assert len(decode_keys(b"", data)[1]) <= 16


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A pseudo-terminal: the operator's end, and ours."""
    operator, ours = pty.openpty()
    yield operator, ours
    for fd in (operator, ours):
        with contextlib.suppress(OSError):
            os.close(fd)


def read_keys(keyboard: Keyboard, count: int) -> tuple[str, ...]:
    keys: tuple[str, ...] = ()
    end = time.monotonic() + SLACK_S
    while len(keys) < count and time.monotonic() < end:
        keys += keyboard.read(timeout_s=0.2)
    return keys


def test_keys_come_at_once_and_unseen(terminal: tuple[int, int]) -> None:
    operator, ours = terminal
    with Keyboard(ours) as keyboard:
        assert keyboard.read() == ()
        os.write(operator, b"w\x1b[A")
        assert read_keys(keyboard, 2) == ("w", "up")
        os.write(operator, b"\x1b")
        assert keyboard.read(timeout_s=0.1) == ()
        os.write(operator, b"[")
        assert keyboard.read(timeout_s=0.1) == ()
        os.write(operator, b"D")
        assert read_keys(keyboard, 1) == ("left",)
        os.write(operator, b"\x13\x16 \x1a")  # Ctrl-S, Ctrl-V, space, Ctrl-Z
        assert read_keys(keyboard, 2) == (" ", "suspend")
    assert not select.select([operator], [], [], 0.0)[0]


def test_the_terminal_gets_its_modes_back(terminal: tuple[int, int]) -> None:
    _, ours = terminal

    def fail() -> None:
        with Keyboard(ours):
            modes = termios.tcgetattr(ours)
            assert not modes[LOCAL_MODES] & (termios.ICANON | termios.ECHO)
            assert modes[LOCAL_MODES] & termios.ISIG
            assert not modes[INPUT_MODES] & termios.IXON
            raise KeyboardInterrupt

    before, handler = termios.tcgetattr(ours), signal.getsignal(signal.SIGTSTP)
    with pytest.raises(KeyboardInterrupt):
        fail()
    assert termios.tcgetattr(ours) == before
    assert signal.getsignal(signal.SIGTSTP) is handler


def test_a_terminal_that_goes_is_told_once(terminal: tuple[int, int]) -> None:
    operator, ours = terminal
    with Keyboard(ours) as keyboard:
        os.write(operator, b"w")
        assert read_keys(keyboard, 1) == ("w",)
        os.close(operator)
        assert read_keys(keyboard, 1) == ("hangup",)
        assert keyboard.read(timeout_s=0.01) == ()


def test_without_a_terminal_one_line_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    with pytest.raises(ConfigError, match="keyboard: got 'no terminal', expected a terminal on standard input"):
        Keyboard(reading).__enter__()
    os.close(reading)
    os.close(writing)
    with (tmp_path / "file").open("w+") as file, monkeypatch.context() as patch:
        patch.setattr(sys, "stdin", file)
        with pytest.raises(ConfigError, match="no terminal"):
            Keyboard().__enter__()
        patch.setattr(sys, "stdin", None)
        with pytest.raises(ConfigError, match="no standard input"):
            Keyboard().__enter__()


def wait_until(condition: Callable[[], Any]) -> None:
    end = time.monotonic() + SLACK_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def line(stream: IO[str] | None) -> str:
    assert stream is not None
    return stream.readline().strip()


def test_a_suspended_job_gives_the_terminal_back_and_takes_it_again(terminal: tuple[int, int]) -> None:
    operator, ours = terminal

    def by_lines() -> bool:
        return bool(termios.tcgetattr(operator)[LOCAL_MODES] & termios.ICANON)

    def state() -> str:
        return Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[0]

    command = [sys.executable, "-m", "tests.hardware_bridge.terminal_job"]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=ours, stdout=subprocess.PIPE, start_new_session=True, text=True
    ) as job:
        child = int(line(job.stdout))
        assert not by_lines()
        os.kill(child, signal.SIGTSTP)
        assert line(job.stdout) == "suspending"
        wait_until(lambda: state() == "T")
        assert by_lines()
        os.kill(child, signal.SIGCONT)
        wait_until(lambda: not by_lines())
        os.write(operator, b"w")
        assert line(job.stdout) == "w"
        os.kill(child, signal.SIGTSTP)
        assert line(job.stdout) == "suspending"
        wait_until(lambda: state() == "T")
        os.kill(child, signal.SIGCONT)
        wait_until(lambda: not by_lines())
        os.write(operator, b"q")
        assert line(job.stdout) == "q"
    assert job.returncode == 0
    assert by_lines()
