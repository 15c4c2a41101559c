"""`Runner`: carries a mission out through its links, tick by tick, and measures how late it is."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from hardware_bridge.cameras.source import FrameSource
from hardware_bridge.clocks import MissionClock
from hardware_bridge.command import RobotCommand, SafeCommand
from hardware_bridge.link import LinkError, RobotLink
from hardware_bridge.mission import Mission, Outcome
from hardware_bridge.mission_log_format import MissionEvent, TickTiming
from hardware_bridge.reading import CameraFrame, Sample
from hardware_bridge.safety.supervisor import stopped_commands
from hardware_bridge.safety.watchdog import Watchdog
from hardware_bridge.tick_inputs import HumanInput, KeyEvent, TickInputs

GIVEN_UP_TICKS = 15
"""A robot that did not report for so many ticks is no longer waited for in lock-step."""

LEAVING_S = 2.0


class Person(Protocol):
    """Somebody at the controls."""

    def read(self, now_s: float) -> tuple[tuple[KeyEvent, ...], HumanInput | None]:
        """The keys since the last call, and what they come to."""
        ...


class Operator(Protocol):
    """Who does by hand what robots cannot: `undock` a reserve, `collect` a lost robot."""

    def undock(self, robot: int) -> None: ...
    def collect(self, robot: int) -> None: ...


@dataclass(frozen=True)
class Tick:
    """Everything of one tick, for logs and displays."""

    inputs: TickInputs
    outcome: Outcome
    sent: tuple[RobotCommand, ...]
    timing: TickTiming
    events: tuple[MissionEvent, ...] = ()


@dataclass
class Crew:
    """The robots and cameras that can still be reached, by agent name; those that fail leave."""

    links: dict[str, RobotLink]
    cameras: dict[str, FrameSource]
    silent: dict[str, int] = field(default_factory=dict)
    leaving: list[threading.Thread] = field(default_factory=list)

    def read(self, patience_s: float) -> tuple[dict[str, list[Sample]], dict[str, list[CameraFrame]], dict[str, str]]:
        """What came since the last call; waits so long for whoever has not reported yet."""
        samples: dict[str, list[Sample]] = {name: [] for name in self.links}
        frames: dict[str, list[CameraFrame]] = {name: [] for name in self.cameras}
        failures: dict[str, str] = {}
        end = time.monotonic() + patience_s
        while True:
            for name, link in list(self.links.items()):
                try:
                    samples[name] += link.read()
                except LinkError as error:
                    failures[name] = str(error)
                    self.drop(name)
            for name, camera in list(self.cameras.items()):
                try:
                    frames[name] += camera.read()
                except LinkError as error:
                    failures[f"camera of {name}"] = str(error)
                    self.cameras.pop(name).close()
            if time.monotonic() >= end or not self._missing(samples, frames):
                break
            time.sleep(0.0002)
        for name in self.links:
            self.silent[name] = 0 if samples[name] else self.silent.get(name, 0) + 1
        return samples, frames, failures

    def _missing(self, samples: Mapping[str, list[Sample]], frames: Mapping[str, list[CameraFrame]]) -> bool:
        due = [name for name in self.links if self.silent.get(name, 0) < GIVEN_UP_TICKS]
        return any(not samples[name] for name in due) or any(not frames[n] for n in due if n in self.cameras)

    def send(self, name: str, command: SafeCommand) -> RobotCommand:
        """Send to a robot; what it was really told, which is to stand if it cannot be reached."""
        if name not in self.links:
            return RobotCommand()
        try:
            return self.links[name].send(command)
        except LinkError:
            return RobotCommand()

    def drop(self, name: str) -> None:
        """Let a robot go that has failed; its camera too may be gone, which shows by itself.

        Its link closes in a thread of its own: the others cannot wait for a last word to a robot that is gone.
        """
        closing = threading.Thread(target=self.links.pop(name).close, name=f"closing {name}", daemon=True)
        closing.start()
        self.leaving.append(closing)

    def close(self) -> None:
        """Stop everybody and let go of everything."""
        for link in self.links.values():
            link.stop()
        for part in (*self.links.values(), *self.cameras.values()):
            part.close()
        for closing in self.leaving:
            closing.join(LEAVING_S)


class Runner:
    """Runs a mission.

    Args:
        watch: is shown every tick.
        stopped: asked before every tick; a true answer ends the mission.
    """

    def __init__(
        self,
        mission: Mission,
        crew: Crew,
        clock: MissionClock,
        operator: Operator,
        watchdog: Watchdog,
        *,
        person: Person | None = None,
        watch: Callable[[Tick], None] | None = None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self.mission, self.crew, self.clock = mission, crew, clock
        self._operator, self._watchdog, self._person = operator, watchdog, person
        self._watch, self._stopped = watch, stopped

    def run(self) -> str:
        """Until the mission is over or stopped; says why. The robots stand afterwards, whatever happened."""
        tick_s = self.mission.deployment.rates.tick_s
        due_s = self.clock.now_s()
        try:
            while not self._stopped():
                self.clock.wait_until(due_s)
                tick = self._tick(due_s)
                if self._watch is not None:
                    self._watch(tick)
                if tick.outcome.ended is not None:
                    return tick.outcome.ended
                due_s = max(due_s + tick_s, self.clock.now_s() - tick_s)
            return "stopped"
        finally:
            self._watchdog.close()
            self.crew.close()

    def _tick(self, due_s: float) -> Tick:
        began_s = time.monotonic()
        samples, frames, failures = self.crew.read(self.clock.patience_s)
        now_s = self.clock.now_s()
        keys, human = self._person.read(now_s) if self._person else ((), None)
        inputs = TickInputs(
            time_s=now_s,
            samples={name: tuple(own) for name, own in samples.items() if own},
            frames={name: tuple(own) for name, own in frames.items() if own},
            keys=keys,
            human=human,
            failures=failures,
        )
        outcome = self.mission.tick(inputs)
        took_s, events = self.clock.now_s() - now_s, outcome.events
        commands = outcome.safe
        if took_s > self.mission.deployment.safety.deadman_s:  # the policy's answer is to a question of long ago
            commands = stopped_commands(len(commands))
            events += (f"answer after {took_s:.2f} s, too late to be sent",)
        sent = tuple(self.crew.send(name, safe) for name, safe in zip(self.mission.names, commands, strict=True))
        self._watchdog.feed()
        self.mission.note_sent(sent)
        for robot in outcome.undock:
            self._operator.undock(robot)
        for robot in outcome.collect:
            self._operator.collect(robot)
        newest_s = max((s.host_s for own in samples.values() for s in own), default=None)
        latency_s = None if newest_s is None else self.clock.now_s() - newest_s
        timing = TickTiming(now_s, now_s - due_s, time.monotonic() - began_s, latency_s)
        left = [MissionEvent(now_s, "left", text, name) for name, text in failures.items()]
        told = [MissionEvent(now_s, "policy", text) for text in events]
        return Tick(inputs, outcome, sent, timing, (*left, *told))
