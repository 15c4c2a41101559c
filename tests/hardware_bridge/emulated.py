"""A simulator's server in a thread, and a mission whose robots are all of its kind."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from coop_envs.policy import Policy
from coop_envs.scenario import Scenario, load_scenario
from hardware_bridge.clocks import LockstepClock
from hardware_bridge.deployment import Deployment, load_deployment
from hardware_bridge.emulators.emulated_world import EmulatedWorld
from hardware_bridge.emulators.simulator import SimulatorServer
from hardware_bridge.mission import Mission
from hardware_bridge.preflight import connect_all
from hardware_bridge.runner import Crew, Runner, Tick
from hardware_bridge.safety.watchdog import Watchdog
from hardware_bridge.simulator_client import SimulatorClient
from hardware_bridge.wiring import make_crew


@contextmanager
def serving(scenario: Scenario, *, lockstep: bool = True, seed: int = 0) -> Iterator[SimulatorServer]:
    """A server that runs in the meantime."""
    server, stop = SimulatorServer(EmulatedWorld(scenario, "heldout", 0, seed), lockstep=lockstep), threading.Event()
    thread = threading.Thread(target=server.serve, args=(stop.is_set,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        alive = thread.is_alive()
        stop.set()
        thread.join(5.0)
    assert alive, "the server died"


def rubble() -> Scenario:
    """Three surveyors."""
    return load_scenario("rubble", fidelity="features")


def settled(server: SimulatorServer, **changes: Any) -> Deployment:
    """What a host is told of the server's team, as `EmulationProcess.settled` would have it."""
    site, team = server.world.site(), server.world.scenario.team
    plan, cell_m = site["plan"], site["map"]["cell_m"]
    robots = {
        member.name: {"link": {"kind": "simulator", "port": server.address[1], "robot": i}}
        | ({"camera": {"kind": "simulator"}} if member.camera else {})
        for i, member in enumerate(team.members)
    }
    place = {"start": plan["start"], "map_corner_m": plan["corner"], "dock": plan["dock"]}
    place |= {"map_size_m": [cells * cell_m for cells in site["map_shape"]]}
    place |= {"goal": plan["goal"][:3]} if plan["goal"][3] else {}
    known = {name: site[name] for name in ("rates", "estimation", "map", "seeing", "collects_lost")}
    return load_deployment({"team": team, "robots": robots, "site": place, **known, **changes})


OFF: dict[str, Any] = {"inchworm": False, "barrier": False, "max_accel_m_s2": None}
"""Safety limits that leave a policy's commands as they are."""


class Team:
    """A mission's parts against a server in lock-step; ``run`` goes on for so many decisions."""

    def __init__(self, server: SimulatorServer, policy: Policy | None, *, seed: int = 0, **changes: Any) -> None:
        self.deployment = settled(server, **{"safety": OFF, **changes})
        self.mission = Mission(self.deployment, policy, seed)
        self._advancer = SimulatorClient(server.address)
        self.clock = LockstepClock(self._advancer, self.deployment.rates.tick_s)
        self.links, cameras = make_crew(self.deployment, server.address, self.clock.now_s)
        connect_all(self.links, cameras, str)
        self.crew = Crew(dict(self.links), dict(cameras))
        self.ticks: list[Tick] = []
        self.asked: list[tuple[str, int]] = []

    def run(self, decisions: int, watch: Callable[[Tick], object] = lambda tick: None) -> str:
        """Until so many decisions are made, or the mission ends; says why."""
        made = 0

        def seen(tick: Tick) -> None:
            nonlocal made
            made += tick.outcome.decided
            self.ticks.append(tick)
            watch(tick)

        watchdog = Watchdog(self.links, 5.0)
        runner = Runner(
            self.mission, self.crew, self.clock, self, watchdog, watch=seen, stopped=lambda: made >= decisions
        )
        try:
            return runner.run()
        finally:
            self._advancer.close()

    def undock(self, robot: int) -> None:
        self.asked.append(("undock", robot))

    def collect(self, robot: int) -> None:
        self.asked.append(("collect", robot))
