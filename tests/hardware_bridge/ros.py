"""A real roscore, the emulated Zumy's process on it, and a simulator small enough to say what it was told."""

from __future__ import annotations

import atexit
import contextlib
import functools
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hardware_bridge import ros1
from hardware_bridge.link import LinkError
from hardware_bridge.protocols.datagrams import decode, encode

PATIENCE_S = 20.0
ROOT = Path(__file__).parents[2]


def until(condition: Callable[[], Any], patience_s: float = PATIENCE_S) -> Any:
    """What the condition gives once it gives something."""
    end = time.monotonic() + patience_s
    while True:
        found = condition()
        if found or time.monotonic() > end:
            assert found, "it never came to be"
            return found
        time.sleep(0.005)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def roscore(log_folder: Path) -> Iterator[str]:
    """The address of a master that runs in the meantime."""
    port = free_port()
    uri = f"http://127.0.0.1:{port}"
    with (log_folder / f"roscore_{port}.txt").open("w") as log:
        process = subprocess.Popen(
            ["roscore", "-p", str(port)],
            stdout=log,
            stderr=log,
            env=os.environ | {"ROS_LOG_DIR": str(log_folder), "ROS_IP": "127.0.0.1", "ROS_MASTER_URI": uri},
            start_new_session=True,
        )
        try:
            until(lambda: answers(uri))
            yield uri
        finally:
            kill_family(process)


def kill_family(process: subprocess.Popen[Any]) -> None:
    """Kill a process and its children at once; roscore's are in sessions of their own."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.kill()
    process.wait()
    for child in children:
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(child), signal.SIGKILL)


def answers(uri: str) -> bool:
    try:
        ros1.ask_master(uri)
    except LinkError:
        return False
    return True


class SmallSimulator:
    """One robot that turns its wheels at once and by itself, 30 ticks a second; ``told`` is every "set" message."""

    def __init__(self) -> None:
        self.told: list[dict[str, Any]] = []
        self.blobs: list[list[float]] | None = None
        self.tick, self.wheels, self.angles = 0, [0.0, 0.0], [0.0, 0.0]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(1 / 30)
        self._listeners: set[Any] = set()
        self._open = True
        self._thread = threading.Thread(target=self._run)

    @property
    def address(self) -> tuple[str, int]:
        return self._socket.getsockname()

    def last(self, name: str) -> Any:
        """What a set-point was last told, None if never."""
        return next((m[name] for m in reversed(self.told) if name in m), None)

    def __enter__(self) -> SmallSimulator:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._open = False
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        due = time.monotonic()
        while self._open:
            with contextlib.suppress(TimeoutError):
                data, sender = self._socket.recvfrom(65536)
                self._take(decode(data) or {"kind": ""}, sender)
            if time.monotonic() >= due:
                due = time.monotonic() + 1 / 30
                self._step()

    def _take(self, message: dict[str, Any], sender: Any) -> None:
        if message["kind"] == "hello":
            self._listeners.add(sender)
            self._socket.sendto(encode({"kind": "welcome", "robot": 0, "name": "zumy", "tick": 0}), sender)
        elif message["kind"] == "set":
            self.wheels = message.get("wheels", self.wheels)
            self.told.append(message)

    def _step(self) -> None:
        self.tick += 1
        self.angles = [angle + wheel / 30 for angle, wheel in zip(self.angles, self.wheels, strict=True)]
        state = {
            "kind": "state", "robot": 0, "tick": self.tick, "time_s": self.tick / 30, "powered": True, "docked": False,
            "gyro": [0.1, 0.2, 0.3], "accel": [1.0, 2.0, 9.0], "angles": self.angles, "wheels": self.wheels,
            "voltage": 7.4, "current": 1.0, "brightness": 0.0, "blobs": self.blobs, "spot": None,
        }  # fmt: skip
        for listener in self._listeners:
            self._socket.sendto(encode(state), listener)


class EmulatedNode:
    """The firmware emulator's process."""

    def __init__(self, master: str, simulator: tuple[str, int], namespace: str, *more: str) -> None:
        host, port = simulator
        self.namespace = namespace
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "hardware_bridge.emulators.zumy_ros1", "--robot", "0", "--master", master),
                *("--simulator", f"{host}:{port}", "--namespace", namespace, *more),
            ],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ready(self) -> EmulatedNode:
        """Wait for its line."""
        assert self.process.stdout is not None
        assert json.loads(self.process.stdout.readline()) == {"ready": True, "port": self.namespace}
        return self

    def fault(self, fault: str, **more: float) -> None:
        """Begin a fault."""
        assert self.process.stdin is not None
        print(json.dumps({"fault": fault, **more}), file=self.process.stdin, flush=True)

    def end(self) -> int:
        """Close its stdin, and wait until it is gone."""
        with contextlib.suppress(BrokenPipeError, ValueError):
            self.process.communicate(timeout=PATIENCE_S)
        return self.process.wait(PATIENCE_S)


@contextlib.contextmanager
def emulated(master: str, namespace: str, *more: str) -> Iterator[tuple[SmallSimulator, EmulatedNode]]:
    """A small simulator and an emulated Zumy of its."""
    with SmallSimulator() as simulator:
        node = EmulatedNode(master, simulator.address, namespace, *more)
        try:
            yield simulator, node.ready()
        finally:
            node.process.kill()
            node.process.communicate()


@functools.cache
def process_master() -> str:
    """The one master that this test process speaks to; it ends with the process."""
    stack = contextlib.ExitStack()
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    atexit.register(stack.close)
    return stack.enter_context(roscore(folder))
