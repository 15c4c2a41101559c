"""Run a policy on robots, real or emulated, behind the safety supervisor; or replay a mission's log."""

from __future__ import annotations

import json
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from coop_envs.cli import parse
from coop_envs.errors import ConfigError, require
from coop_envs.policy import load_policy
from hardware_bridge.mission_display import Display, tally_table
from hardware_bridge.mission_replay import replay_mission
from hardware_bridge.session import Order, Tally, prepared

DRY_RUN_S = 5.0


@dataclass(frozen=True)
class Options:
    """Run a policy on robots, real or emulated, behind the safety supervisor.

    Ctrl-C stops every robot and ends the mission; its log is kept.
    """

    policy: str | None = None
    """A policy by name, a training's folder, an .onnx file, or a .py file that defines make_policy()."""
    team: Path | None = None
    """The team file (.yaml): robots, links, cameras, site or emulation, safety limits."""
    log: Path = Path("out/mission.mcap")
    """Where to record the mission (.mcap)."""
    seed: int = 0
    """Seed of the policy."""
    time_limit_s: float | None = None
    """Ends the mission after so many seconds, in place of the team file's limit."""
    dry_run: bool = False
    """Send nothing; print what would be sent and which limits it would hit (5 s, unless --time-limit-s says more)."""
    keyboard: bool = False
    """Let a person at this terminal take over (`coop play` prints the keys)."""
    replay: Path | None = None
    """Replay this log instead and compare beliefs and commands, bit for bit."""
    json: bool = False
    """Print what the mission came to as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run ``coop deploy``; 0 at the mission's end, 1 if a replay differs, 130 if interrupted."""
    options = parse(Options, "deploy", argv)
    if options.replay is not None:
        return replay(options.replay, options.policy, options.json)
    if options.policy is None:
        raise ConfigError("policy", None, "a policy by name or path")
    require(options.team is not None, "team", options.team, "a team file (.yaml)")
    assert options.team is not None
    limit_s = options.time_limit_s
    require(limit_s is None or limit_s > 0, "time_limit_s", limit_s, "more than 0 s")
    if options.dry_run and limit_s is None:
        limit_s = DRY_RUN_S
    order = Order(
        team_file=options.team,
        policy_name=options.policy,
        policy=load_policy(options.policy),
        seed=options.seed,
        log=None if options.dry_run else options.log,
        dry_run=options.dry_run,
        time_limit_s=limit_s,
        command=" ".join(["coop deploy", *argv]),
    )
    return run(order, options.keyboard, options.json)


def run(order: Order, keyboard: bool, as_json: bool) -> int:
    """Run a mission with a display on stderr; the exit code."""
    console = Console(stderr=True)
    interrupted = threading.Event()
    with ExitStack() as stack:
        stack.enter_context(_interrupts(interrupted))
        display = Display(console, order)
        person = display.keyboard(stack) if keyboard else None
        session = stack.enter_context(
            prepared(order, display.say, person=person, watch=display.show, stopped=_any(interrupted, display))
        )
        with display:
            tally = session.run()
    tell(tally, order, console, as_json)
    return 130 if interrupted.is_set() else 0


def tell(tally: Tally, order: Order, console: Console, as_json: bool) -> None:
    """Print what a mission came to."""
    if as_json:
        sys.stdout.write(json.dumps(tally.document(), indent=2) + "\n")
    else:
        Console().print(tally_table(tally))
    if order.log is not None:
        console.print(f"log in {order.log}", soft_wrap=True)


def replay(log: Path, policy: str | None, as_json: bool) -> int:
    """Replay a log and say whether it came out the same."""
    result = replay_mission(log, policy)
    same = result.difference is None
    text = "beliefs and commands are the same, bit for bit" if same else f"differs first: {result.difference}"
    if as_json:
        sys.stdout.write(json.dumps(vars(result)) + "\n")
    else:
        sys.stdout.write(f"{result.ticks} ticks, {result.decisions} decisions: {text}\n")
        sys.stdout.write(f"{result.note}\n" if result.note else "")
    return 0 if same else 1


def _any(interrupted: threading.Event, display: Display) -> Callable[[], bool]:
    return lambda: interrupted.is_set() or display.quit


class _interrupts:  # noqa: N801  a context manager
    """Ctrl-C and SIGTERM end the mission in good order; a second one at once."""

    def __init__(self, event: threading.Event) -> None:
        self._event = event

    def __enter__(self) -> None:
        self._before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        for number in self._before:
            signal.signal(number, self._take)

    def __exit__(self, *unused: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: object) -> None:
        del number, frame
        if self._event.is_set():
            raise KeyboardInterrupt
        self._event.set()
