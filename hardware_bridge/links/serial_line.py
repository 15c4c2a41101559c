"""`SerialLine`: what links over serial ports share: an open port, a thread that serves it, the samples it brings."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable

from hardware_bridge.link import LinkError
from hardware_bridge.links.serial_port import SerialPort
from hardware_bridge.reading import Sample

WAITING_SAMPLES = 1000


class SerialLine:
    """A port to one robot. Whoever writes holds ``lock``; ``samples`` are the thread's to add to, `read`'s to take."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.lock = threading.RLock()
        self.samples: deque[Sample] = deque(maxlen=WAITING_SAMPLES)
        self._port: SerialPort | None = None
        self._gone: LinkError | None = None
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()

    def open(self, port: SerialPort) -> None:
        """Use this port from now on."""
        self._port, self._gone = port, None
        self._closing.clear()

    def serve(self, step: Callable[[SerialPort], None]) -> None:
        """Call ``step`` with the open port, again and again, in a thread, until the port is gone or closed."""
        assert self._port is not None
        self._thread = threading.Thread(target=self._run, args=(self._port, step), name=self._name, daemon=True)
        self._thread.start()

    def read(self) -> list[Sample]:
        """Everything that arrived since the last call, oldest first.

        Raises:
            LinkError: the port is gone, and all that came before has been read.
        """
        samples = [self.samples.popleft() for _ in range(len(self.samples))]
        if not samples and self._gone:
            raise self._gone
        return samples

    def put(self, data: bytes) -> None:
        """Write.

        Raises:
            LinkError: the port is gone, or was never opened.
        """
        if self._gone or self._port is None:
            raise self._gone or LinkError(f"{self._name}: got a closed link, expected one that is connected")
        try:
            self._port.write(data)
        except LinkError as error:
            self._gone = LinkError(f"{self._name}: {error}")
            raise self._gone from None

    def put_urgent(self, data: bytes) -> None:
        """Write in place of all that waits; never raises."""
        with contextlib.suppress(LinkError):
            if self._port is not None:
                self._port.write(data, urgent=True)

    def close(self) -> None:
        """End the thread and let go of the port; never raises."""
        self._closing.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=1.0)
        with self.lock:
            port, self._port, self._thread = self._port, None, None
        if port is not None:
            port.close()

    def _run(self, port: SerialPort, step: Callable[[SerialPort], None]) -> None:
        try:
            while not self._closing.is_set():
                step(port)
        except LinkError as error:
            self._gone = LinkError(f"{self._name}: {error}")
