"""Faults put into an emulated team on the wall clock, one after another, and judged.

    python -m tests.hardware_bridge.fault_campaign TEAM SEED COUNT

A process of its own, since rospy knows one master a process; prints a `Verdict` for each fault as a line of JSON. The
judge asks the simulator a hundred times a second what each robot was last told; what the supervisor answers is recorded
on the way. A fault during which the judge itself was kept waiting says nothing, and is put again.
"""

from __future__ import annotations

import dataclasses
import json
import random
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from coop_envs.device import prepare
from coop_envs.errors import CoopError
from hardware_bridge.deployment import load_deployment
from hardware_bridge.emulation import EmulationProcess
from hardware_bridge.mission import DEVICE
from tests.hardware_bridge.fault_host import Host
from tests.hardware_bridge.faults import (
    ALLOWED_S,
    DEAF,
    DELAY_S,
    ENDS_EMULATION,
    HARMLESS,
    LEAVES,
    Fault,
    Verdict,
    deck,
    team_of,
)
from tests.hardware_bridge.ros import free_port

WATCHED_S, ASKED_S, STARVED_S, PATIENCE_S, AGAIN = 0.9, 0.01, 0.1, 15.0, 3
CAMERA, POLICY = ("blind",), ("nan", "exception", "shape", "left out", "hang", "slow")
Seen = list[tuple[float, tuple[bool, ...]]]


class Campaign:
    """An emulated team that is broken and mended; use as a context manager."""

    def __init__(self, team: str, seed: int) -> None:
        self.team, self._chance = team, random.Random(seed)
        self._stack = ExitStack()
        self._emulation: EmulationProcess | None = None
        self._host: Host | None = None

    def __enter__(self) -> Self:
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        self._file = folder / "team.yaml"
        self._file.write_text(json.dumps(team_of(self.team, f"http://127.0.0.1:{free_port()}")))
        self._stack.callback(self._end_emulation)
        prepare(DEVICE)
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def put(self, fault: Fault) -> Verdict:
        """Put a fault until the judge could see how it went."""
        for attempt in range(AGAIN):
            verdict, starved = self._try(fault)
            if not starved:
                break
            print(f"again: {fault}, attempt {attempt}, the judge was kept waiting {starved:.2f} s", file=sys.stderr)
        return verdict

    def _try(self, fault: Fault) -> tuple[Verdict, float]:
        """How it went, and how long the judge was kept waiting if that was too long."""
        host = self._driving()
        time.sleep(self._chance.uniform(0.0, 0.4))
        began = time.monotonic()
        self._break(fault)
        seen = self._watch(began + WATCHED_S + (DELAY_S if fault.kind == "late" else 0.0))
        if host.policy.hangs_since is not None:
            began = host.policy.hangs_since
        worst_s, wrong = self._judged(fault, host, began, seen)
        wrong += self._mend(fault, host)
        gaps = [b[0] - a[0] for a, b in zip([(began, ())] + seen, seen, strict=False)]
        verdict = Verdict(self.team, fault.kind, fault.robot, worst_s, tuple(wrong))
        return verdict, max(gaps) if max(gaps) > STARVED_S else 0.0

    def _break(self, fault: Fault) -> None:
        host, emulation = self._there()
        match fault.kind:
            case kind if kind in POLICY:
                host.policy.way = kind
            case "blind":
                for name in host.names:
                    emulation.tell({"robot": name, "camera": False})
            case "roscore":
                emulation.tell({"kill_roscore": True})
            case "kill":
                emulation.tell({"robot": fault.robot, "kill": True})
            case "late":
                emulation.tell({"robot": fault.robot, "fault": "late", "delay_s": DELAY_S})
            case "clock_jump":
                jump_s = self._chance.choice([-1000.0, -0.5, 0.5, 1000.0])
                emulation.tell({"robot": fault.robot, "fault": "clock_jump", "jump_s": jump_s})
            case kind:
                emulation.tell({"robot": fault.robot, "fault": kind})

    def _watch(self, until: float) -> Seen:
        seen: Seen = []
        while time.monotonic() < until:
            seen.append(self._look())
            time.sleep(ASKED_S)
        return seen

    def _look(self) -> tuple[float, tuple[bool, ...]]:
        """When, and who was last told to stand."""
        _, emulation = self._there()
        truth = emulation.truth()
        return time.monotonic(), tuple(wheels == [0.0, 0.0] for wheels in truth["set_wheels"])

    def _judged(self, fault: Fault, host: Host, began: float, seen: Seen) -> tuple[float | None, list[str]]:
        """The worst time to zero, and what was not as demanded."""
        stops = [] if fault.kind in HARMLESS else [fault.robot] if fault.robot else host.names
        times: list[float] = []
        wrong: list[str] = []
        for i, name in enumerate(host.names):
            stood = [at - began for at, stands in seen if stands[i]]
            if name not in stops:
                wrong += [f"{name} stopped after {stood[0]:.3f} s, expected it to go on"] if stood else []
                continue
            told = [t.at - began for t in host.told if t.at >= began and t.stands[i]]
            told += [at - began for at in host.trips.get(name, []) if at >= began]
            zero_s = min(told, default=float("inf"))
            if zero_s > ALLOWED_S:
                wrong.append(f"{name}: the host told zero after {zero_s:.3f} s, expected at most {ALLOWED_S} s")
            times.append(zero_s)
            if self._is_deaf(fault):
                continue
            late_s = DELAY_S if fault.kind == "late" else 0.0
            own_s = min(stood, default=float("inf")) - late_s
            if own_s > ALLOWED_S:
                wrong.append(f"{name}: zero after {own_s + late_s:.3f} s, expected at most {ALLOWED_S + late_s} s")
            times.append(own_s)
            again = [at - began for at, stands in seen if at - began > own_s + late_s and not stands[i]]
            if again and not self._may_resume(fault):
                wrong.append(f"{name}: drives again after {again[0]:.3f} s")
        return max(times, default=None), wrong

    def _kind_of(self, fault: Fault) -> str:
        return team_of(self.team)["robots"][fault.robot]["link"]["kind"] if fault.robot else ""

    def _is_deaf(self, fault: Fault) -> bool:
        """Whether the robot hears nothing, and has no run that ends by itself."""
        runs_out = fault.kind == "unplug" and self._kind_of(fault) == "velociroach_xbee"
        return fault.kind in DEAF and not runs_out

    def _may_resume(self, fault: Fault) -> bool:
        """A VelociRoACH stamps nothing: that its answers are late shows only as they begin to be."""
        return fault.kind == "late" and self._kind_of(fault) == "velociroach_xbee"

    def _mend(self, fault: Fault, host: Host) -> list[str]:
        """End the fault; what went wrong when a deaf robot heard again."""
        emulation, wrong = self._there()[1], []
        host.policy.way = None
        if fault.kind == "blind":
            for name in host.names:
                emulation.tell({"robot": name, "camera": True})
        if fault.kind in ENDS_EMULATION:
            self._end_emulation()
        elif fault.robot is not None:
            i = host.names.index(fault.robot)
            host.policy.rest = True
            if fault.kind in LEAVES:
                self._end_host()
            emulation.tell({"robot": fault.robot, "fault": "heal"})
            if fault.kind in LEAVES:
                self._plugged_in(fault.robot)
                self._host = Host(self._deployment, emulation.address)
                wrong += [] if self._look()[1][i] else [f"{fault.robot}: was not told to stand on being plugged in"]
                self._host.start()
            elif not self._until(lambda stands: stands[i], 2.0):
                wrong.append(f"{fault.robot}: does not obey after it hears again")
        host.policy.rest, host.policy.hangs_since = False, None
        return wrong

    def _plugged_in(self, robot: str) -> None:
        """Wait until the robot's port is there again."""
        port, end = Path(getattr(self._deployment.robots[robot].link, "port", "/")), time.monotonic() + PATIENCE_S
        while not port.exists() and time.monotonic() < end:
            time.sleep(ASKED_S)

    def _until(self, condition, patience_s: float) -> bool:
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            if condition(self._look()[1]):
                return True
            time.sleep(ASKED_S)
        return False

    def _driving(self) -> Host:
        """A host whose robots all drive; what is broken is made anew."""
        if self._host is not None and not self._host.whole:
            self._end_host()
        if self._emulation is None:
            self._emulation = EmulationProcess(self._file).__enter__()
            self._deployment = self._emulation.settled(load_deployment(self._file))
        if self._host is None:
            self._host = Host(self._deployment, self._emulation.address)
            self._host.start()
        if not self._until(lambda stands: not any(stands), PATIENCE_S):
            raise CoopError(
                f"team: got robots that stand ({self._host.ended or self._look()[1]}), expected all to drive"
            )
        time.sleep(0.1)
        return self._host

    def _there(self) -> tuple[Host, EmulationProcess]:
        assert self._emulation is not None
        return self._host, self._emulation  # type: ignore[return-value]

    def _end_host(self) -> None:
        host, self._host = self._host, None
        if host is not None:
            host.close()

    def _end_emulation(self) -> None:
        self._end_host()
        emulation, self._emulation = self._emulation, None
        if emulation is not None:
            emulation.__exit__(None, None, None)


def main(team: str, seed: str, count: str) -> None:
    with Campaign(team, int(seed)) as campaign:
        for fault in deck(team, int(seed), int(count)):
            print(json.dumps(dataclasses.asdict(campaign.put(fault))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
