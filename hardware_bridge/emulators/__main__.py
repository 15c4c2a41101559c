"""An emulated team: ``python -m hardware_bridge.emulators TEAM.yaml``.

Starts a simulator, one process of firmware for each robot of the team file, and a roscore where one is needed and none
runs. When all can be reached it prints one line of JSON, `EmulatedTeam.ready`. Lines of JSON on its standard input
break things: ``{"robot": "picket_0", "fault": "freeze"}`` (see `quirks.FaultCommand`; a robot without firmware knows
freeze, silent and garbage), ``{"robot": "picket_0", "kill": true}``, ``{"robot": "picket_0", "camera": false}``,
``{"kill_roscore": true}``. It ends with its input.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from coop_envs.cli import guarded
from coop_envs.errors import ConfigError, CoopError, require
from coop_envs.scenario import load_scenario
from coop_envs.validation import known, validated
from hardware_bridge.cameras.ros1_camera import Ros1CameraSettings
from hardware_bridge.deployment import Deployment, Emulation, load_deployment
from hardware_bridge.emulators.emulated_world import EmulatedWorld
from hardware_bridge.emulators.quirks import Quirks
from hardware_bridge.emulators.simulator import SimulatorServer
from hardware_bridge.link import LinkError
from hardware_bridge.links.simulator_udp import SimulatorUdpSettings
from hardware_bridge.links.velociroach_xbee import VelociroachSettings
from hardware_bridge.links.zumy_ros1 import ZumyRos1Settings
from hardware_bridge.links.zumy_serial import ZumySerialSettings
from hardware_bridge.ros1 import ask_master

READY_S = 30.0
Process = subprocess.Popen[str]


class EmulatedTeam:
    """The processes of an emulated team."""

    def __init__(self, deployment: Deployment, emulation: Emulation) -> None:
        _check_quirks(deployment, emulation)
        scenario = load_scenario(emulation.scenario, team=deployment.team, fidelity="features", **emulation.overrides)
        world = EmulatedWorld(scenario, emulation.split, emulation.world, emulation.seed)
        self._deployment, self._emulation = deployment, emulation
        self._server = SimulatorServer(world, lockstep=emulation.lockstep)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._server.serve, args=(self._stop.is_set,), daemon=True)
        self._robots: dict[str, Process] = {}
        self._roscore: Process | None = None
        self._world, self._site = world, world.site()
        self._ports = tempfile.TemporaryDirectory(prefix="coop_ports_")

    def start(self) -> dict[str, Any]:
        """Start everything; what the host has to know.

        Raises:
            CoopError: a process that did not come up, with what it said.
        """
        self._thread.start()
        masters = {w.link.master for w in self._deployment.robots.values() if isinstance(w.link, ZumyRos1Settings)}
        for master in sorted(masters):
            self._roscore = _roscore(master) or self._roscore
        ports: dict[str, str | None] = {}
        for i, (name, command) in enumerate(self._commands().items()):
            ports[name] = None
            if command is not None:
                self._robots[name] = _spawn([*command, *self._common(name, i)])
        for name, process in self._robots.items():
            ports[name] = _ready(name, process)
        host, port = self._server.address
        return {"ready": True, "host": host, "port": port, "site": self._site, "ports": ports}

    def _commands(self) -> dict[str, list[str] | None]:
        found: dict[str, list[str] | None] = {}
        for member in self._deployment.team.members:
            wiring = self._deployment.robots[member.name]
            match wiring.link:
                case ZumySerialSettings():
                    command = [*_module("zumy_firmware"), *self._port_link(member.name)]
                case VelociroachSettings() as link:
                    command = [*_module("velociroach_firmware"), *self._port_link(member.name)]
                    command += ["--address", hex(link.address)]
                    command += ["--hat", str(link.hat_brightness)]
                case ZumyRos1Settings() as link:
                    command = [*_module("zumy_ros1"), "--master", link.master, "--namespace", link.namespace]
                    command += ["--dialect", link.dialect]
                    command += ["--camera"] * isinstance(wiring.camera, Ros1CameraSettings)
                case SimulatorUdpSettings():
                    command = None
            found[member.name] = command
        return found

    def _port_link(self, name: str) -> list[str]:
        """A name for the port that stays when it is unplugged and plugged in again."""
        return ["--port-link", str(Path(self._ports.name) / name)]

    def _common(self, name: str, robot: int) -> list[str]:
        host, port = self._server.address
        quirks = {**self._emulation.quirks.get("all", {}), **self._emulation.quirks.get(name, {})}
        lockstep = self._emulation.lockstep and not isinstance(self._deployment.robots[name].link, ZumyRos1Settings)
        common = ["--simulator", f"{host}:{port}", "--robot", str(robot), "--quirks", json.dumps(quirks)]
        return [*common, *(["--lock-step"] if lockstep else [])]

    def take(self, message: Mapping[str, Any]) -> None:
        """Break something.

        Raises:
            ConfigError: there is no such thing to break.
        """
        if message.get("kill_roscore") and self._roscore is not None:
            _kill_family(self._roscore)
            return
        names = [member.name for member in self._deployment.team.members]
        name = known(str(message.get("robot")), names, "robot", "one of the team")
        robot, process = names.index(name), self._robots.get(name)
        if "camera" in message:
            (self._world.blind.discard if message["camera"] else self._world.blind.add)(robot)
        elif process is None or process.stdin is None:
            self._server.begin(robot, str(message.get("fault")))
        elif message.get("kill"):
            process.kill()
        else:
            process.stdin.write(json.dumps({k: v for k, v in message.items() if k != "robot"}) + "\n")
            process.stdin.flush()

    def close(self) -> None:
        """End every process."""
        self._stop.set()
        everyone = [*self._robots.values(), *([self._roscore] if self._roscore else [])]
        for process in everyone:
            process.terminate()
        for process in everyone:
            try:
                process.wait(3.0)
            except subprocess.TimeoutExpired:
                process.kill()
        self._ports.cleanup()


def _check_quirks(deployment: Deployment, emulation: Emulation) -> None:
    for name, values in emulation.quirks.items():
        validated(Quirks, values, f"emulation.quirks.{name}")
        plain = name != "all" and isinstance(deployment.robots[name].link, SimulatorUdpSettings)
        require(not plain, f"emulation.quirks.{name}", values, "none: a link of kind simulator has no firmware")


def _module(name: str) -> list[str]:
    return [sys.executable, "-m", f"hardware_bridge.emulators.{name}"]


def _spawn(command: Sequence[str]) -> Process:
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)


def _ready(name: str, process: Process) -> str:
    assert process.stdout is not None and process.stderr is not None
    timer = threading.Timer(READY_S, process.kill)
    timer.start()
    for line in process.stdout:
        if line.startswith("{"):
            timer.cancel()
            threading.Thread(target=_drain, args=(process,), daemon=True).start()
            return str(json.loads(line)["port"])
    timer.cancel()
    said = " ".join(process.stderr.read().split())[-300:]
    raise CoopError(f"robots.{name}: got no emulated robot ({said or 'it said nothing'}), expected one that starts")


def _drain(process: Process) -> None:
    """Keep the pipe of what firmware complains of from filling up."""
    assert process.stderr is not None
    for line in process.stderr:
        sys.stderr.write(line)


def _roscore(master: str) -> Process | None:
    """A roscore at the address, None if one runs there already."""
    if _answers(master):
        return None
    if shutil.which("roscore") is None:
        raise ConfigError("roscore", None, "ROS 1 (Debian: apt install python3-rospy python3-roslaunch)")
    port = urllib.parse.urlsplit(master).port or 11311
    quiet = subprocess.DEVNULL
    process: Process = subprocess.Popen(
        ["roscore", "-p", str(port)], stdin=quiet, stdout=quiet, stderr=quiet, text=True, start_new_session=True
    )
    end = time.monotonic() + READY_S
    while time.monotonic() < end:
        if _answers(master):
            return process
        time.sleep(0.1)
    process.kill()
    raise CoopError(f"roscore: got no answer at {master}, expected one that starts")


def _kill_family(process: Process) -> None:
    """Kill a process and its children at once: roscore's are in sessions of their own, and would live on."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.kill()
    for child in children:
        os.kill(int(child), signal.SIGKILL)


def _answers(master: str) -> bool:
    try:
        ask_master(master)
    except LinkError:
        return False
    return True


def main(argv: Sequence[str]) -> int:
    """Run an emulated team until standard input ends."""
    if len(argv) != 1:
        raise ConfigError("arguments", " ".join(argv), "one team file with an emulation")
    deployment = load_deployment(json.loads(argv[0]) if argv[0].startswith("{") else argv[0])
    if deployment.emulation is None:
        raise ConfigError("emulation", None, "an emulation in the team file")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with ExitStack() as stack:
        team = EmulatedTeam(deployment, deployment.emulation)
        stack.callback(team.close)
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        sys.stdout.write(json.dumps(team.start()) + "\n")
        sys.stdout.flush()
        for line in sys.stdin:
            try:
                team.take(json.loads(line))
            except (ValueError, CoopError, OSError) as error:
                sys.stderr.write(f"{error}\n")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    sys.exit(guarded(lambda: main(sys.argv[1:])))
