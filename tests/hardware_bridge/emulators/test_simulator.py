"""The simulator's server over real sockets: lock-step waits for commands, garbage does no harm, many may listen."""

from __future__ import annotations

import json
import socket

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hardware_bridge.link import LinkError
from hardware_bridge.protocols.datagrams import KINDS
from hardware_bridge.simulator_client import SimulatorClient
from tests.hardware_bridge.emulated import rubble, serving
from tests.hardware_bridge.ros import until

VALUE = st.recursive(
    st.none() | st.booleans() | st.integers() | st.integers(10**308, 10**310) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
HARMLESS = sorted(KINDS - {"advance"})
FIELDS = ("robot", "wheels", "brightness", "laser", "galvo", "undock", "collect", "tick")


@pytest.fixture(scope="module")
def server():
    with serving(rubble()) as server:
        yield server


@pytest.fixture
def judge(server):
    client = SimulatorClient(server.address)
    yield client
    client.close()


def advance(judge, ticks=1):
    tick = judge.hello()["tick"] + ticks
    return judge.ask({"kind": "advance", "tick": tick}, "advanced")["tick"]


def test_welcome_tells_who_one_is(server):
    client = SimulatorClient(server.address, 1)
    welcome = client.hello()
    assert welcome["name"] == server.world.scenario.team.members[1].name
    assert welcome["tick_s"] == pytest.approx(1 / 30)
    client.close()


@pytest.mark.parametrize("robot", [99, -1, "1", 1.5, [1]])
def test_a_robot_that_is_none_of_the_team_is_refused(server, robot):
    client = SimulatorClient(server.address, robot)
    with pytest.raises(LinkError, match="expected one of the team"):
        client.hello()
    client.close()


def test_lock_step_waits_for_the_set_points_of_everyone_who_listens(judge, server):
    """Commands that come after the question for the tick, before it is answered, apply to it."""
    clients = [SimulatorClient(server.address, i) for i in range(3)]
    for client in clients:
        client.hello()
    for round_ in range(20):
        tick = judge.hello()["tick"] + 1
        judge.send({"kind": "advance", "tick": tick})
        for client in clients:
            client.set(wheels=[0.1 * round_, 0.2])
        until(lambda: [m for m in judge.poll() if m["kind"] == "advanced"])
        truth = judge.ask({"kind": "truth"}, "truth")
        assert truth["tick"] == tick
        assert truth["set_wheels"] == [[0.1 * round_, 0.2]] * 3
    for client in clients:
        client.close()


def test_a_robot_that_says_nothing_holds_up_nobody_for_ever(judge, server):
    client = SimulatorClient(server.address, 2)
    client.hello()
    assert advance(judge, 3) == judge.hello()["tick"]
    client.close()


def test_two_may_listen_to_one_robot(judge, server):
    first, second = SimulatorClient(server.address, 1), SimulatorClient(server.address, 1)
    for client in (first, second):
        client.hello()
        client.poll()
    tick = advance(judge)
    heard = [until(lambda c=client: [m for m in c.poll() if m.get("tick") == tick])[-1] for client in (first, second)]
    assert heard[0] == heard[1]
    assert heard[0]["robot"] == 1
    first.close()
    second.close()


def test_an_answer_to_an_earlier_question_is_not_taken_for_this_ones(judge, server):
    tick = judge.hello()["tick"]
    for _ in range(3):
        judge.send({"kind": "truth"})
    until(lambda: judge.hello())
    judge.ask({"kind": "advance", "tick": tick + 1}, "advanced")
    assert judge.ask({"kind": "truth"}, "truth")["tick"] == tick + 1


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.binary(max_size=100)
    | VALUE.map(lambda value: json.dumps(value).encode())
    | st.tuples(st.sampled_from(HARMLESS), st.dictionaries(st.sampled_from(FIELDS), VALUE)).map(
        lambda made: json.dumps({**made[1], "kind": made[0]}).encode()
    )
)
def test_a_strangers_garbage_does_no_harm(server, judge, data):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(data, server.address)
    assert judge.hello()["tick_s"] == pytest.approx(1 / 30)


@pytest.mark.parametrize(
    "data",
    [
        b'{"kind": []}',
        b'{"kind": "operator", "undock": 5, "collect": {"a": 1}}',
        b'{"kind": "set", "robot": 0, "galvo": [1e300, 0], "wheels": [1e300, 1e300]}',
        b'{"kind": "set", "robot": 0, "wheels": [' + b"9" * 400 + b", 0]}",
        b'{"kind": "set", "robot": "' + "é".encode() * 25_000 + b'"}',
    ],
)
def test_datagrams_that_once_ended_the_server(server, judge, data):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(data, server.address)
    advance(judge)
    assert judge.ask({"kind": "truth"}, "truth")


def test_on_the_wall_clock_time_passes_by_itself():
    with serving(rubble(), lockstep=False) as server:
        client = SimulatorClient(server.address, 0)
        first = client.hello()["tick"]
        client.set(wheels=[3.0, 3.0])
        state = until(lambda: [m for m in client.poll() if m["kind"] == "state" and m["tick"] > first + 10])[-1]
        assert state["wheels"][0] > 1.0
        client.close()
