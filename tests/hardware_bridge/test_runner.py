"""The runner against a simulator's process: who fails leaves, and whatever happens, all stand afterwards."""

from __future__ import annotations

import time

import pytest

from coop_envs.scenario import load_scenario
from hardware_bridge.link import LinkError
from tests.hardware_bridge.emulated import Team, rubble, serving
from tests.hardware_bridge.ros import until
from tests.hardware_bridge.test_mission import Scripted


def stands(server):
    return until(lambda: all(wheels == [0.0, 0.0] for wheels in server.world.truth()["set_wheels"]))


def unplug(link):
    """Take a link's socket away, as a robot that is out of reach would."""

    def gone():
        raise LinkError(f"{link.name}: got nothing, expected a robot")

    link.read = gone


def test_who_fails_leaves_and_the_others_go_on():
    with serving(rubble()) as server:
        team = Team(server, Scripted())
        gone = team.mission.names[2]
        team.run(6, lambda tick: unplug(team.links[gone]) if len(team.ticks) == 20 else None)
        stands(server)
    assert gone not in team.crew.links
    left = [event for tick in team.ticks for event in tick.events if event.kind == "left"]
    assert [(event.robot, gone in event.text) for event in left] == [(gone, True)]
    last = team.ticks[-1]
    assert not last.outcome.safe[0].command.stands and not last.outcome.safe[1].command.stands
    assert last.outcome.safe[2].command.stands and last.sent[2].stands


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError, LinkError("gone")])
def test_an_exception_leaves_all_standing_and_every_link_closed(error):
    def fail(tick):
        if len(team.ticks) == 15:
            raise error

    with serving(rubble()) as server:
        team = Team(server, Scripted())
        with pytest.raises((KeyboardInterrupt, ZeroDivisionError, LinkError)):
            team.run(6, fail)
        assert any(not safe.command.stands for safe in team.ticks[-1].outcome.safe)
        stands(server)
        assert all(link.read() == [] for link in team.links.values())


def test_a_tick_is_timed():
    with serving(rubble()) as server:
        team = Team(server, Scripted())
        began = time.monotonic()
        team.run(3)
        took_s = time.monotonic() - began
    timings = [tick.timing for tick in team.ticks]
    assert 0.0 < sum(timing.busy_s for timing in timings) <= took_s
    assert [round(timing.time_s * 30) for timing in timings] == list(range(len(timings)))
    assert all(timing.late_s == pytest.approx(0.0, abs=1e-9) for timing in timings)
    assert all(timing.measurement_to_command_s == pytest.approx(0.0, abs=1e-9) for timing in timings[1:])


def test_reserves_are_called_and_lost_robots_are_taken_away():
    """Two pickets fall silent; they are given up, people are asked to take them away and to put a reserve down."""
    with serving(load_scenario("arena", team="scouts", fidelity="features")) as server:
        team = Team(server, Scripted(), collects_lost=True)
        server.world.operate({"collect": [1, 2]})
        team.run(60)
    asked = dict.fromkeys(team.asked)
    assert ("collect", 1) in asked and ("collect", 2) in asked
    reserves = [i for i, member in enumerate(team.deployment.team.members) if member.reserve]
    assert [robot for what, robot in asked if what == "undock"] == reserves[: sum(w == "undock" for w, _ in asked)]
    assert any(what == "undock" for what, _ in asked)
