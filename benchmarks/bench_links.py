"""Serial links over a pseudo-terminal: round trips, polling at 100 Hz, time of the codecs. Prints, writes JSON.

    python benchmarks/bench_links.py [--out FILE.json] [--seconds S]

A Zumy's emulated firmware runs as a process of its own; here is the host. Round trips are T packets, written and read
through the link's port with nothing else under way. While polling, the simulator gives an IMU sample every 2 ms, so a
poll without an answer is one that was lost; set-points go out thirty times a second, and may poll too. Aims: 100 Hz,
under 2 ms.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import select
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from coop_envs.agents.catalog import load_hat, load_robot
from hardware_bridge.links.serial_port import SerialPort
from hardware_bridge.links.zumy_serial import ZumySerialLink, ZumySerialSettings
from hardware_bridge.protocols import datagrams
from hardware_bridge.protocols.datagrams import MAX_BYTES
from hardware_bridge.protocols.roach_commands import encode_profile
from hardware_bridge.protocols.xbee_frames import FrameParser, Transmit, encode
from hardware_bridge.protocols.zumy_packets import (
    BAUD,
    PacketParser,
    Sensors,
    encode_sensors,
    encode_time,
    encode_wheels,
)
from hardware_bridge.safety.supervisor import stopped_commands

ROUND_TRIPS, REPEATS, TICK_S = 2000, 5000, 0.002
REPORT = Sensors(1, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (5, 6), (1.0, 1.0), 0.7, 0.2)


def simulate(server: socket.socket, stopped: threading.Event) -> None:
    """A robot that stands, told to whoever said hello."""
    state = {"kind": "state", "robot": 0, "powered": True, "gyro": [0.0] * 3, "accel": [0.0, 0.0, 9.8], "voltage": 7.4}
    state |= {"angles": [0.0, 0.0], "wheels": [0.0, 0.0]}
    listeners, tick = set(), 0
    while not stopped.wait(TICK_S):
        while select.select([server], [], [], 0)[0]:
            data, sender = server.recvfrom(MAX_BYTES)
            if (datagrams.decode(data) or {}).get("kind") == "hello":
                listeners.add(sender)
                server.sendto(datagrams.encode({"kind": "welcome", "tick": 0, "tick_s": TICK_S}), sender)
        tick += 1
        for listener in listeners:
            server.sendto(datagrams.encode({**state, "tick": tick, "time_s": tick * TICK_S}), listener)


@contextlib.contextmanager
def emulated_zumy() -> Iterator[str]:
    """The port of an emulated robot."""
    server, stopped = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), threading.Event()
    server.bind(("127.0.0.1", 0))
    thread = threading.Thread(target=simulate, args=(server, stopped))
    thread.start()
    command = [sys.executable, "-m", "hardware_bridge.emulators.zumy_firmware", "--robot", "0"]
    command += ["--simulator", "{}:{}".format(*server.getsockname())]
    firmware = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert firmware.stdout is not None
        yield json.loads(firmware.stdout.readline())["port"]
    finally:
        firmware.communicate()
        stopped.set()
        thread.join()
        server.close()


def round_trips_ms(path: str) -> list[float]:
    port, parser, times = SerialPort(path, BAUD), PacketParser(), []
    for k in range(ROUND_TRIPS):
        started = time.perf_counter()
        port.write(encode_time(sequence=k))
        while not parser.feed(port.read(1.0)):
            pass
        times.append(1e3 * (time.perf_counter() - started))
    port.close()
    return times


def polled(path: str, seconds: float) -> dict[str, float]:
    """Polls and answers of a link that is also sent set-points, thirty times a second."""
    settings = ZumySerialSettings(port=path)
    link = ZumySerialLink("zumy", load_robot("zumy"), load_hat("hat0"), settings, time.monotonic)
    link.connect()
    (still,) = stopped_commands(1)
    time.sleep(0.2)
    link.read()
    polls, answers, started, samples = link.polls, link.answers, time.monotonic(), 0
    while time.monotonic() < started + seconds:
        link.send(still)
        samples += len(link.read())
        time.sleep(1 / 30)
    took_s = time.monotonic() - started
    row = {"polls_hz": (link.polls - polls) / took_s, "samples_hz": samples / took_s}
    row |= {"unanswered": link.polls - polls - (link.answers - answers), "bytes_dropped": link.dropped}
    link.close()
    return row


def each_us(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    for _ in range(REPEATS):
        work()
    return 1e6 * (time.perf_counter() - started) / REPEATS


def codecs_us() -> dict[str, float]:
    report, frame = encode_sensors(REPORT), encode(Transmit(0x2052, encode_profile((5.0, 5.0), 100)))
    packets, frames = PacketParser(), FrameParser()
    return {
        "zumy_encode_command": each_us(lambda: encode_wheels(5.0, 5.0)),
        "zumy_decode_sensors": each_us(lambda: packets.feed(report)),
        "xbee_encode_profile": each_us(lambda: encode(Transmit(0x2052, encode_profile((5.0, 5.0), 100)))),
        "xbee_decode_profile": each_us(lambda: frames.feed(frame)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    parser.add_argument("--seconds", type=float, default=5.0, help="of polling")
    options = parser.parse_args()
    with emulated_zumy() as path:
        times = round_trips_ms(path)
        polling = polled(path, options.seconds)
    trip = {"median_ms": statistics.median(times), "p99_ms": statistics.quantiles(times, n=100)[98]}
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    rows = {"machine": machine, "round_trip": trip, "polling": polling, "codecs_us": codecs_us()}
    print(f"round trip: median {trip['median_ms']:.3f} ms, 99 % within {trip['p99_ms']:.3f} ms")
    print(f"polling: {polling['polls_hz']:.1f} Hz, {polling['samples_hz']:.1f} samples a second, ", end="")
    print(f"{polling['unanswered']:.0f} polls without an answer, {polling['bytes_dropped']:.0f} bytes in no packet")
    for name, cost in rows["codecs_us"].items():
        print(f"{name}: {cost:.1f} us")
    if options.out:
        options.out.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
