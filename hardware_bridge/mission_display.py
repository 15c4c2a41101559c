"""What a person sees of a mission in the terminal: what is done before it starts, how it stands, what it came to."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table

from coop_envs.estimation.belief import Declared
from hardware_bridge.deployment import Deployment
from hardware_bridge.keyboard import Keyboard
from hardware_bridge.manual_drive import text
from hardware_bridge.mission import Mission
from hardware_bridge.person import Driver
from hardware_bridge.runner import Person, Tick
from hardware_bridge.session import Order, Tally

REFRESH_TICKS = 15
LINE_PERIOD_S = 10.0


class Display:
    """A live table on a terminal, a line every ten seconds elsewhere, every command of a dry run."""

    def __init__(self, console: Console, order: Order) -> None:
        self._console, self._order = console, order
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._driver: Driver | None = None
        self._ticks = 0
        self._line_due_s = 0.0
        self._open: Keyboard | None = None

    @property
    def quit(self) -> bool:
        """Whether the person at the keyboard wants to end."""
        return self._driver is not None and self._driver.quit

    def say(self, line: str) -> None:
        """A line above the table."""
        self._console.print(line, soft_wrap=True, highlight=False, markup=False)

    def keyboard(self, stack: ExitStack) -> Callable[[Deployment], Person]:
        """Open the keyboard now; who makes the person once the team is known."""
        self._open = stack.enter_context(Keyboard())

        def person(deployment: Deployment) -> Person:
            assert self._open is not None
            self._driver = Driver(self._open, deployment.team.members)
            return self._driver

        return person

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, mission: Mission, tick: Tick) -> None:
        """Show a tick."""
        for event in tick.events:
            self.say(f"{tick.inputs.time_s:8.2f} s  {event.robot or 'team'} {event.kind}: {event.text}")
        if self._order.dry_run and tick.outcome.decided:
            self._show_dry(mission, tick)
        self._ticks += 1
        if self._live is not None and self._ticks % REFRESH_TICKS == 0:
            self._live.update(team_table(mission, tick, self._driver), refresh=True)
        elif self._live is None and tick.inputs.time_s >= self._line_due_s:
            self._line_due_s = tick.inputs.time_s + LINE_PERIOD_S
            self.say(f"{tick.inputs.time_s:8.1f} s  {status_line(mission)}")

    def _show_dry(self, mission: Mission, tick: Tick) -> None:
        held = {i.robot: f"{i.rule}: {i.reason}" for i in tick.outcome.interventions}
        for name, wanted, safe in zip(mission.names, tick.outcome.wanted, tick.outcome.safe, strict=True):
            left, right = safe.command.wheels_rad_s
            line = f"{tick.inputs.time_s:8.2f} s  {name}: would send wheels {left:+.2f} {right:+.2f} rad/s"
            line += f", hat {safe.command.brightness:.2f}, laser {safe.command.laser:.1f}"
            if safe.command != wanted:
                line += f" (wanted {wanted.wheels_rad_s[0]:+.2f} {wanted.wheels_rad_s[1]:+.2f})"
            self.say(line + (f"  [{held[name]}]" if name in held else ""))


def status_line(mission: Mission) -> str:
    """Where everybody is, in a line."""
    position, declared = mission.belief.position.numpy()[0], mission.belief.declared.numpy()[0]
    robots = zip(mission.names, position, declared, strict=True)
    return "  ".join(f"{name} ({p[0]:+.2f}, {p[1]:+.2f}) {Declared(int(d)).name.lower()}" for name, p, d in robots)


def team_table(mission: Mission, tick: Tick, driver: Driver | None) -> Table:
    """How every robot stands."""
    title = f"{tick.inputs.time_s:.1f} s"
    caption = text(mission.deployment.team.members, driver.state) if driver else None
    table = Table("robot", "x m", "y m", "heading deg", "sigma cm", "battery", "state", "held by", title=title)
    table.caption = caption
    belief = mission.belief
    position, R = belief.position.numpy()[0], belief.rotation.numpy()[0]
    covariance, declared = belief.pose_covariance.numpy()[0], belief.declared.numpy()[0]
    held = {i.robot: i.rule for i in tick.outcome.interventions}
    for i, name in enumerate(mission.names):
        if declared[i] == int(Declared.DOCKED):
            continue
        sigma_cm = 100.0 * math.sqrt(max(np.linalg.eigvalsh(covariance[i, 3:5, 3:5])[-1], 0.0))
        heading = f"{math.degrees(math.atan2(R[i, 1, 0], R[i, 0, 0])):.0f}"
        battery = mission.window.battery(i)
        state = Declared(int(declared[i])).name.lower()
        state += ", rests" if belief.stationary.numpy()[0, i] else ""
        place = f"{position[i, 0]:.2f}", f"{position[i, 1]:.2f}", heading
        charge = "" if battery is None else f"{battery:.0%}"
        table.add_row(name, *place, f"{sigma_cm:.1f}", charge, state, held.get(name, ""))
    return table


def tally_table(tally: Tally) -> Table:
    """What a mission came to."""
    table = Table("", "", title="mission", show_header=False)
    document = tally.document()
    table.add_row("ended", f"{tally.ended} ({tally.time_s:.1f} s, {tally.decisions} decisions)")
    for name, label in (("latency_ms", "measurement to command"), ("late_ms", "ticks late")):
        marks = document[name]
        if marks is not None:
            table.add_row(label, f"median {marks['median']} ms, 99 % {marks['p99']} ms, most {marks['max']} ms")
    for name, count in sorted(tally.interventions.items()):
        table.add_row("held", f"{name} ({count} times)")
    errors = tally.position_errors_m()
    if errors is not None:
        table.add_row("position error, in truth", ", ".join(f"{100 * error:.1f} cm" for error in errors))
    return table
