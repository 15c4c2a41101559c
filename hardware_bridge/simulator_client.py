"""`SimulatorClient`: one robot's line to a simulator's process; firmware emulators and the UDP link share it."""

from __future__ import annotations

import contextlib
import socket
import time
from typing import Any

from hardware_bridge.link import LinkError
from hardware_bridge.protocols.datagrams import MAX_BYTES, Datagram, decode, encode

HELLO_S = 0.2


class SimulatorClient:
    """A socket that hears of one robot (None: of no robot, for operators and judges) and tells it set-points.

    ``fileno`` lets it stand in `select`.
    """

    def __init__(self, address: tuple[str, int], robot: int | None = None) -> None:
        self.address, self.robot = address, robot
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.connect(address)
        self._socket.setblocking(False)

    def fileno(self) -> int:
        """The socket's file descriptor."""
        return self._socket.fileno()

    def hello(self, timeout_s: float = 2.0) -> Datagram:
        """Say who we are until the simulator says welcome.

        Raises:
            LinkError: it does not.
        """
        return self.ask({"kind": "hello", "robot": self.robot}, "welcome", timeout_s)

    def ask(self, question: Datagram, answer: str, timeout_s: float = 2.0) -> Datagram:
        """Send a question until its answer comes; what else comes meanwhile is dropped.

        Raises:
            LinkError: no answer, or an error as answer.
        """
        self.poll()  # an answer to an earlier question that was asked twice is no answer to this one
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            self.send(question)
            again = time.monotonic() + HELLO_S
            while time.monotonic() < again:
                for message in self.poll():
                    if message["kind"] == "error":
                        raise LinkError(f"simulator {self.address}: {message.get('text')}")
                    if message["kind"] == answer:
                        return message
                time.sleep(0.0005)
        host, port = self.address
        raise LinkError(f"simulator {host}:{port}: got no answer, expected a running simulator")

    def send(self, message: Datagram) -> None:
        """Send a message; one that cannot be sent is lost, as on any network."""
        with contextlib.suppress(OSError):
            self._socket.send(encode(message))

    def set(self, **set_points: Any) -> None:
        """Tell the robot any of wheels, brightness, laser, galvo."""
        self.send({"kind": "set", "robot": self.robot, **set_points})

    def poll(self) -> list[Datagram]:
        """Every message that waits, oldest first."""
        messages: list[Datagram] = []
        while True:
            try:
                data = self._socket.recv(MAX_BYTES)
            except (BlockingIOError, OSError):
                return messages
            message = decode(data)
            if message is not None:
                messages.append(message)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()
