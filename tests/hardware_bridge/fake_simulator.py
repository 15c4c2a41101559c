"""A simulator of one robot on flat nothing: wheels do what they are told, and every set-point is remembered."""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
import threading
import time

from hardware_bridge.command import RobotCommand, SafeCommand, supervisors_seal
from hardware_bridge.protocols.datagrams import decode, encode

TICK_S = 1 / 30
GYRO, ACCEL, VOLTAGE, CURRENT = (0.1, -0.2, 0.3), (0.5, -1.0, 9.8), 7.4, 1.0


def safe(*wheels, **others):
    return SafeCommand(RobotCommand(wheels or (0.0, 0.0), **others), supervisors_seal())


def wait_until(condition, timeout_s=10.0):
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.005)
    raise AssertionError("the condition did not come true in time")


class FakeSimulator:
    """Runs in a thread, on the wall clock or, with ``lockstep``, at calls of `advance`."""

    def __init__(self, lockstep=False, tick_s=TICK_S):
        self.lockstep, self.tick_s, self.tick, self.powered = lockstep, tick_s, 0, True
        self.wheels, self.angles, self.brightness, self.laser = [0.0, 0.0], [0.0, 0.0], 0.0, 0.0
        self.galvo, self.sets = [], []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._told, self._closing = None, False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._closing = True
        self._thread.join()
        self._socket.close()

    @property
    def address(self):
        return "{}:{}".format(*self._socket.getsockname())

    def advance(self):
        self.tick += 1
        for side in (0, 1):
            self.angles[side] += self.wheels[side] * self.tick_s
        if self._told:
            self._socket.sendto(encode(self._state()), self._told)

    def _state(self):
        names = {"gyro": GYRO, "accel": ACCEL, "angles": self.angles, "wheels": self.wheels, "blobs": None}
        power = {"powered": self.powered, "docked": False, "voltage": VOLTAGE, "current": CURRENT}
        return {"kind": "state", "robot": 0, "tick": self.tick, "time_s": self.tick * self.tick_s, **names, **power}

    def _run(self):
        due = time.monotonic()
        while not self._closing:
            if select.select([self._socket], [], [], 0.02 if self.lockstep else max(due - time.monotonic(), 0))[0]:
                data, sender = self._socket.recvfrom(60000)
                self._take(decode(data), sender)
            elif not self.lockstep:
                self.advance()
                due = max(due + self.tick_s, time.monotonic())

    def _take(self, message, sender):
        if message["kind"] == "hello":
            self._told = sender
            self._socket.sendto(encode({"kind": "welcome", "tick": self.tick, "tick_s": self.tick_s}), sender)
        elif message["kind"] == "set":
            self.sets.append(message)
            self.wheels = message.get("wheels", self.wheels)
            self.brightness, self.laser = message.get("brightness", self.brightness), message.get("laser", self.laser)
            if "galvo" in message:
                self.galvo.append(message["galvo"])


class Emulator:
    """A firmware emulator's process, which takes faults."""

    def __init__(self, module, simulator, *options, quirks=None):
        command = [sys.executable, "-m", f"hardware_bridge.emulators.{module}", "--simulator", simulator.address]
        command += ["--robot", "0", "--quirks", json.dumps(quirks or {}), *options]
        if simulator.lockstep:
            command.append("--lock-step")
        env = {**os.environ, "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env)
        assert self.process.stdin and self.process.stdout
        self._input, self._output = self.process.stdin, self.process.stdout
        self.ready = json.loads(self._output.readline())
        self.port = self.ready["port"]

    def fault(self, name, **values):
        self._input.write(json.dumps({"fault": name, **values}) + "\n")
        self._input.flush()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._input.close()
        assert self.process.wait(timeout=10) == 0
        self._output.close()
