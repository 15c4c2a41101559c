"""`EmulationProcess`: an emulated team beside the bridge, started, asked where it is, and ended with the mission."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from coop_envs.errors import CoopError
from coop_envs.estimation.settings import Estimation, MapSettings, Rates
from coop_envs.validation import validated
from hardware_bridge.deployment import Deployment, Site, Wiring
from hardware_bridge.links.simulator_udp import SimulatorUdpSettings
from hardware_bridge.links.velociroach_xbee import VelociroachSettings
from hardware_bridge.links.zumy_serial import ZumySerialSettings
from hardware_bridge.protocols.datagrams import Datagram
from hardware_bridge.seeing import Seeing
from hardware_bridge.simulator_client import SimulatorClient

READY_S = 180.0
"""The first start on a machine compiles the simulation."""
ENDING_S = 10.0


class EmulationProcess:
    """The processes behind a team file with an ``emulation``; use as a context manager.

    Raises:
        CoopError: on entry, if they do not come up: in their own words.
    """

    def __init__(self, team_file: str | Path) -> None:
        self._team_file = str(team_file)
        self._judge: SimulatorClient | None = None

    def __enter__(self) -> Self:
        pipe, command = subprocess.PIPE, [sys.executable, "-m", "hardware_bridge.emulators", self._team_file]
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        self._said: list[str] = []
        self._ear = threading.Thread(target=self._hear_complaints, daemon=True)
        self._ear.start()
        timer = threading.Timer(READY_S, self._process.kill)
        timer.start()
        try:
            self.ready = self._first_line()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        finally:
            timer.cancel()
        self.address = (str(self.ready["host"]), int(self.ready["port"]))
        self._judge = SimulatorClient(self.address)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._judge is not None:
            self._judge.close()
        assert self._process.stdin is not None and self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # it died with something unread
            self._process.stdin.close()
        try:
            self._process.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()
        self._ear.join(2.0)

    def _first_line(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{"):
                return json.loads(line)
        self._ear.join(2.0)
        told = next((line for line in reversed(self._said) if line), "it said nothing")
        raise CoopError(told.removeprefix("error: "))

    def _hear_complaints(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as complaints:
            for line in complaints:
                self._said.append(line.strip())
                del self._said[:-50]

    def tell(self, message: dict[str, Any]) -> None:
        """Break something; see `hardware_bridge.emulators.__main__`."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(message) + "\n")
        self._process.stdin.flush()

    def truth(self) -> Datagram:
        """Where the robots really are, for judges.

        Raises:
            LinkError: the simulator does not answer.
        """
        assert self._judge is not None
        return self._judge.ask({"kind": "truth"}, "truth")

    def settled(self, deployment: Deployment) -> Deployment:
        """The deployment with what only the emulation knows: site, settings of the scenario, addresses."""
        site, plan = self.ready["site"], self.ready["site"]["plan"]
        settings = validated(MapSettings, site["map"], "emulation.map")
        size = [cells * settings.cell_m for cells in site["map_shape"]]
        goal = plan["goal"][:3] if plan["goal"][3] else None
        place = {"start": plan["start"], "dock": plan["dock"], "goal": goal, "map_corner_m": plan["corner"]}
        limit_s = min(deployment.time_limit_s, site["time_limit_s"])
        return replace(
            deployment,
            site=validated(Site, {**place, "map_size_m": size}, "emulation.site"),
            emulation=None,
            robots={m.name: self._reached(deployment, i) for i, m in enumerate(deployment.team.members)},
            rates=validated(Rates, site["rates"], "emulation.rates"),
            estimation=validated(Estimation, site["estimation"], "emulation.estimation"),
            map=settings,
            seeing=validated(Seeing, site["seeing"], "emulation.seeing"),
            time_limit_s=limit_s,
            collects_lost=bool(site["collects_lost"]),
        )

    def _reached(self, deployment: Deployment, robot: int) -> Wiring:
        name = deployment.team.members[robot].name
        wiring, port = deployment.robots[name], self.ready["ports"][name]
        match wiring.link:
            case SimulatorUdpSettings() as link:
                host, number = self.address
                return replace(wiring, link=replace(link, host=host, port=number, robot=robot))
            case ZumySerialSettings() | VelociroachSettings() as link:
                return replace(wiring, link=replace(link, port=port))
            case _:
                return wiring


class SimulatedOperator:
    """The people of an emulated team."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._client = SimulatorClient(address)

    def undock(self, robot: int) -> None:
        """Put a reserve down at the dock."""
        self._client.send({"kind": "operator", "undock": [robot]})

    def collect(self, robot: int) -> None:
        """Take a lost robot away."""
        self._client.send({"kind": "operator", "collect": [robot]})

    def close(self) -> None:
        """Let go of the socket."""
        self._client.close()
