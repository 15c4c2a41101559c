"""A mission from its team file to its end: emulation, belief, links, pre-flight, log, and what it came to."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from coop_envs.device import prepare
from coop_envs.errors import require
from coop_envs.geometry.arrays import to_numpy
from coop_envs.policy import Policy
from coop_envs.recording.log_format import MEASUREMENTS
from hardware_bridge.clocks import LockstepClock, MissionClock, WallClock
from hardware_bridge.deployment import Deployment, load_deployment
from hardware_bridge.dry_link import DryLink
from hardware_bridge.emulation import EmulationProcess, SimulatedOperator
from hardware_bridge.link import LinkError, RobotLink
from hardware_bridge.mission import DEVICE, Mission
from hardware_bridge.mission_frame import mission_frame, mission_world
from hardware_bridge.mission_log import MissionLog
from hardware_bridge.mission_log_format import BELIEF, MissionMetadata
from hardware_bridge.placement import check_places
from hardware_bridge.preflight import connect_all, listen
from hardware_bridge.runner import Crew, Operator, Person, Runner, Tick
from hardware_bridge.safety import stopped_commands
from hardware_bridge.safety.watchdog import Watchdog, WatchdogTrip
from hardware_bridge.simulator_client import SimulatorClient
from hardware_bridge.steady import frozen_heap, preload
from hardware_bridge.wiring import make_crew

WATCHDOG_S = 0.25
LOCKSTEP_WATCHDOG_S = 2.0
REST_BRIGHTNESS = 0.5
Say = Callable[[str], object]


@dataclass(frozen=True)
class Order:
    """What to run: a team file with a policy (None: a person alone drives), and where to log it."""

    team_file: Path
    policy_name: str
    policy: Policy | None
    seed: int
    log: Path | None
    dry_run: bool = False
    time_limit_s: float | None = None
    command: str = ""


@dataclass
class Tally:
    """What a mission came to."""

    ended: str = ""
    time_s: float = 0.0
    decisions: int = 0
    interventions: Counter[str] = field(default_factory=Counter)
    events: list[str] = field(default_factory=list)
    latency_s: list[float] = field(default_factory=list)
    late_s: list[float] = field(default_factory=list)
    truth: dict[str, Any] | None = None
    belief_xy: list[list[float]] = field(default_factory=list)

    def add(self, tick: Tick) -> None:
        """Count a tick."""
        self.time_s = tick.timing.time_s
        self.late_s.append(tick.timing.late_s)
        self.interventions.update(f"{i.robot}: {i.rule}" for i in tick.outcome.interventions if not i.again)
        self.events += [f"{event.robot or 'team'} {event.kind}: {event.text}" for event in tick.events]
        if tick.outcome.decided:
            self.decisions += 1
            if tick.timing.measurement_to_command_s is not None:
                self.latency_s.append(tick.timing.measurement_to_command_s)

    def document(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "ended": self.ended,
            "time_s": round(self.time_s, 3),
            "decisions": self.decisions,
            "latency_ms": _percentiles(self.latency_s),
            "late_ms": _percentiles(self.late_s),
            "interventions": dict(self.interventions),
            "events": self.events,
            "true_position_error_m": self.position_errors_m(),
        }

    def position_errors_m(self) -> list[float] | None:
        """How far each robot's believed position is from the true one; None where nobody knows the truth."""
        if self.truth is None:
            return None
        away = np.asarray(self.truth["position"])[:, :2] - np.asarray(self.belief_xy)
        return np.linalg.norm(away, axis=1).round(5).tolist()


def _percentiles(values_s: list[float]) -> dict[str, float] | None:
    if not values_s:
        return None
    marks = np.percentile(values_s, [50, 99, 100]) * 1e3
    return dict(zip(("median", "p99", "max"), marks.round(3).tolist(), strict=True))


@dataclass
class Session:
    """A mission that is ready to run: every robot answers and stands."""

    mission: Mission
    runner: Runner
    clock: MissionClock
    emulation: EmulationProcess | None
    tally: Tally

    def run(self) -> Tally:
        """Until it ends; the robots stand afterwards."""
        self.tally.ended = self.runner.run()
        if self.emulation is not None:
            self.tally.belief_xy = self.mission.belief.position.numpy()[0, :, :2].tolist()
            with suppress(LinkError):  # an emulation that has died takes the truth with it, not the mission's account
                self.tally.truth = self.emulation.truth()
        return self.tally


@contextmanager
def prepared(
    order: Order,
    say: Say,
    *,
    person: Callable[[Deployment], Person] | None = None,
    watch: Callable[[Mission, Tick], None] | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Iterator[Session]:
    """Everything up to the first tick; on leaving, robots stand, the log is whole, emulated robots are gone.

    Raises:
        CoopError: whatever is wrong, before anything moves.
    """
    prepare(DEVICE)
    preload()
    deployment = load_deployment(order.team_file)
    text = order.team_file.read_text(encoding="utf-8")
    if order.log is not None:
        check_path(order.log)
    with ExitStack() as stack:
        emulation: EmulationProcess | None = None
        lockstep = False
        if deployment.emulation is not None:
            lockstep = deployment.emulation.lockstep
            say("starting the emulated robots")
            emulation = stack.enter_context(EmulationProcess(order.team_file))
            deployment = emulation.settled(deployment)
        if order.time_limit_s is not None:
            deployment = replace(deployment, time_limit_s=order.time_limit_s)
        mission = Mission(deployment, order.policy, order.seed)
        tick_s = deployment.rates.tick_s
        clock: MissionClock = WallClock()
        if emulation is not None and lockstep:
            clock = LockstepClock(stack.enter_context(closing(SimulatorClient(emulation.address))), tick_s)
        links, cameras = make_crew(deployment, emulation.address if emulation else None, clock.now_s)
        if order.dry_run:
            links = {name: DryLink(link) for name, link in links.items()}
        stack.enter_context(frozen_heap())
        connect_all(links, cameras, say)
        crew = Crew(dict(links), dict(cameras))
        stack.callback(crew.close)
        frames = listen(deployment, links, cameras, clock, lambda: _rest(links))
        for line in check_places(deployment, frames):
            say(line)
        say("every robot answers, stands and makes sense")
        log = None
        if order.log is not None:
            log = stack.enter_context(MissionLog(order.log, _metadata(order, text, deployment), waits=lockstep))
            log.write_world(mission_world(mission))
        tally = Tally()
        watchdog = Watchdog(links, LOCKSTEP_WATCHDOG_S if lockstep else WATCHDOG_S, lambda trip: _tell(trip, tally))
        stack.callback(watchdog.close)

        def seen(tick: Tick) -> None:
            tally.add(tick)
            if log is not None:
                write_tick(log, mission, tick)
            if watch is not None:
                watch(mission, tick)

        operator: Operator = People(say)
        if emulation is not None:
            operator = stack.enter_context(closing(SimulatedOperator(emulation.address)))
        driver = person(deployment) if person else None
        runner = Runner(mission, crew, clock, operator, watchdog, person=driver, watch=seen, stopped=stopped)
        yield Session(mission, runner, clock, emulation, tally)


def check_path(log: Path) -> None:
    """Refuse a log's path before anything is started; nothing is written yet.

    Raises:
        ConfigError: another suffix than .mcap, or a folder that cannot be made or written to.
    """
    require(log.suffix == ".mcap", "log", str(log), "a path that ends in .mcap")
    folder = next(folder for folder in log.absolute().parents if folder.exists())
    fits = folder.is_dir() and os.access(folder, os.W_OK) and not log.is_dir()
    require(fits, "log", str(log), "a path that can be written to")


class People:
    """Whoever stands beside the robots, asked in words."""

    def __init__(self, say: Say) -> None:
        self._say = say

    def undock(self, robot: int) -> None:
        """Ask for a reserve."""
        self._say(f"please put robot {robot} down at the dock")

    def collect(self, robot: int) -> None:
        """Ask for a lost robot to be taken away."""
        self._say(f"please take robot {robot} out of the way")


def write_tick(log: MissionLog, mission: Mission, tick: Tick) -> None:
    """A tick in the log; after a decision the belief too."""
    now_s, names = tick.inputs.time_s, mission.names
    log.write_inputs(tick.inputs)
    sent = dict(zip(names, tick.sent, strict=True))
    log.write_commands(now_s, dict(zip(names, tick.outcome.wanted, strict=True)), sent)
    log.write_interventions(tick.outcome.interventions)
    log.write_timing(tick.timing)
    for event in tick.events:
        log.write_event(event)
    if tick.outcome.decided:
        log.write_arrays(MEASUREMENTS, now_s, to_numpy(mission.measurements))
        log.write_arrays(BELIEF, now_s, belief_arrays(mission))
        log.write_frame(mission_frame(mission, now_s))


def belief_arrays(mission: Mission) -> dict[str, Any]:
    """Every array of the belief, and a digest of its map."""
    parts = to_numpy(mission.loop.map)
    digest = hashlib.sha256()
    for name in ("log_odds", "volume"):
        digest.update(np.ascontiguousarray(parts[name]).tobytes())
    return to_numpy(mission.belief) | {"map_sha256": np.frombuffer(digest.digest(), dtype=np.uint8)}


def _rest(links: Mapping[str, RobotLink]) -> None:
    for link, still in zip(links.values(), stopped_commands(len(links), REST_BRIGHTNESS), strict=True):
        link.send(still)


def _tell(trip: WatchdogTrip, tally: Tally) -> None:
    tally.events.append(f"{trip.robot} watchdog: stopped after {trip.silent_s:.3f} s of silence")


def _metadata(order: Order, text: str, deployment: Deployment) -> MissionMetadata:
    path = Path(order.policy_name)
    digest = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
    return MissionMetadata(
        team=text,
        policy=order.policy_name,
        seed=order.seed,
        version=version("coop_envs"),
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        policy_sha256=digest,
        command=order.command,
        settings=json.dumps(asdict(deployment)),
    )
