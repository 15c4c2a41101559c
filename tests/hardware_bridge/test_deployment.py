"""Team files: what is in them, and what is refused, in one line that names the entry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from coop_envs.errors import ConfigError
from hardware_bridge.addresses import addresses_of
from hardware_bridge.deployment import load_deployment
from hardware_bridge.links.velociroach_xbee import VelociroachSettings
from hardware_bridge.links.zumy_ros1 import ZumyRos1Settings
from hardware_bridge.links.zumy_serial import ZumySerialSettings

Tree = dict[str, Any]


def zumy(number: int) -> Tree:
    link = {"kind": "zumy_serial", "port": f"/dev/ttyUSB{number}"}
    return {"link": link, "camera": {"kind": "opencv", "source": 2 * number}}


def team_file() -> Tree:
    """Three Zumys on cables."""
    return {
        "team": "surveyors",
        "robots": {"observer_0": zumy(0), "picket_0": zumy(1), "picket_1": zumy(2)},
        "site": {"start": [[0, 0, 0], [0.5, 0.15, 0], [0.5, -0.15, 0]]},
        "time_limit_s": 60,
    }


def entry(tree: Tree, path: str) -> tuple[Any, Any]:
    *above, last = (int(key) if key.isdigit() else key for key in path.split("."))
    place: Any = tree
    for key in above:
        place = place[key]
    return place, last


def put(path: str, value: Any) -> Callable[[Tree], None]:
    def change(tree: Tree) -> None:
        place, key = entry(tree, path)
        place[key] = value

    return change


def without(path: str) -> Callable[[Tree], None]:
    def change(tree: Tree) -> None:
        place, key = entry(tree, path)
        del place[key]

    return change


def emulated(**emulation: Any) -> Callable[[Tree], None]:
    def change(tree: Tree) -> None:
        del tree["site"]
        tree["emulation"] = emulation

    return change


LINK, CAMERA = "robots.picket_0.link", "robots.picket_0.camera"
REFUSED: dict[str, tuple[Callable[[Tree], None], str]] = {
    "a port twice": (put(f"{LINK}.port", "/dev/ttyUSB0"), f"{LINK}: got '/dev/ttyUSB0', expected another address than"),
    "a port by another path": (put(f"{LINK}.port", "/dev/./ttyUSB0"), f"{LINK}: got '/dev/ttyUSB0', expected another"),
    "a camera twice": (put(f"{CAMERA}.source", 0), f"{CAMERA}: got '/dev/video0', expected another address than"),
    "a camera by its path": (put(f"{CAMERA}.source", "/dev/video0"), f"{CAMERA}: got '/dev/video0', expected another"),
    "no port": (without(f"{LINK}.port"), f"{LINK}.port: got None, expected a serial port"),
    "an empty port": (put(f"{LINK}.port", ""), f"{LINK}.port: got '', expected a serial port"),
    "a port's number": (put(f"{LINK}.port", 3), f"{LINK}.port: got 3"),
    "a baud rate in words": (put(f"{LINK}.baud", "fast"), f"{LINK}.baud: got 'fast', expected a whole number"),
    "a mistyped kind": (put(f"{LINK}.kind", "zumy_serail"), "did you mean 'zumy_serial'?"),
    "no kind": (without(f"{LINK}.kind"), f"{LINK}: got {{'port': '/dev/ttyUSB1'}}, expected a mapping with an entry"),
    "a mistyped entry of a link": (put(f"{LINK}.prot", "x"), f"{LINK}.prot: got 'prot', expected one of: kind, port"),
    "a mistyped entry of a robot": (put("robots.picket_0.lnk", 1), "did you mean 'link'?"),
    "a mistyped limit": (put("safety", {"max_sped": 1}), "did you mean 'max_speed_m_s'?"),
    "a mistyped site": (put("site.strat", 1), "did you mean 'start'?"),
    "a mistyped section": (put("emulatoin", {}), "did you mean 'emulation'?"),
    "a mistyped robot": (put("robots.pickett_0", zumy(3)), "robots: got 'pickett_0', expected one of the team"),
    "a mistyped team": (put("team", "surveyers"), "did you mean 'surveyors'?"),
    "no team": (without("team"), "team: got None, expected a team's name or its members"),
    "no robots": (without("robots"), "robots: got None, expected a mapping"),
    "a list of robots": (put("robots", [1, 2]), "robots: got [1, 2], expected a mapping"),
    "a robot missing": (without("robots.picket_1"), "robots.picket_1: got None, expected how it is reached"),
    "an empty robot": (put("robots.picket_1", None), "robots.picket_1: got None, expected a mapping"),
    "no link": (without(LINK), f"{LINK}: got None, expected a value"),
    "a camera missing": (without(CAMERA), f"{CAMERA}: got None, expected a camera, as the team has it"),
    "a camera too many": (put("team", "inchworm"), f"{CAMERA}: got 'opencv', expected none, as the team has none"),
    "a camera below 0": (put(f"{CAMERA}.source", -1), f"{CAMERA}.source: got -1, expected a device's number"),
    "neither site nor emulation": (without("site"), "site: got None, expected where the robots start, or an emulation"),
    "both": (put("emulation", {}), "site: got 'a site', expected none beside an emulation"),
    "too few starts": (put("site.start", [[0, 0, 0]]), "site.start: got 1, expected 3 poses"),
    "a start without a heading": (put("site.start.1", [0, 1]), "site.start.1.2: got None, expected a value"),
    "a start off the map": (put("site.start.1", [50, 0, 0]), "site.start.1: got (50.0, 0.0), expected on the map"),
    "two starts in one": (put("site.start.2", [0.5, 0.15, 3]), "expected 0.05 m or more from picket_0's"),
    "a start outside the fence": (
        put("safety", {"geofence": [-0.3, -1, 0.3, 1]}),
        "site.start.1: got (0.5, 0.15), expected within safety.geofence",
    ),
    "a fence inside out": (put("safety", {"geofence": [1, 1, 0, 0]}), "safety.geofence: got (1.0, 1.0, 0.0, 0.0)"),
    "a limit below 0": (put("safety", {"max_speed_m_s": -1}), "safety.max_speed_m_s: got -1.0, expected more than 0"),
    "no time": (put("time_limit_s", 0), "time_limit_s: got 0.0, expected more than 0 s"),
    "time with a unit": (put("time_limit_s", "60 s"), "time_limit_s: got '60 s', expected a number in seconds"),
    "rates by another name": (put("rates", {"tick": 0.2}), "did you mean 'tick_s'?"),
    "quirks of nobody": (emulated(quirks={"picket_9": {}}), "emulation.quirks: got 'picket_9', expected all, or one"),
    "a mistyped emulation": (emulated(scenaro="rubble"), "did you mean 'scenario'?"),
}


def test_three_zumys_on_cables() -> None:
    deployment = load_deployment(team_file())
    assert deployment.plan().start.tolist()[0][1] == pytest.approx([0.5, 0.15, 0.0])
    assert deployment.description().decision_s == pytest.approx(0.2)


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_refused_in_one_line(case: str) -> None:
    change, expected = REFUSED[case]
    tree = team_file()
    change(tree)
    with pytest.raises(ConfigError) as refusal:
        load_deployment(tree)
    assert expected in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_radios_port_is_for_one_robot() -> None:
    """Two robots' addresses on the air must differ as well, whatever base station they use."""
    first = VelociroachSettings(port="/dev/ttyUSB0", address=0x2052)
    assert addresses_of(first) == ("/dev/ttyUSB0", "XBee 0x2052")
    assert addresses_of(ZumySerialSettings(port="/dev/ttyUSB0")) == ("/dev/ttyUSB0",)
    assert addresses_of(ZumySerialSettings()) == ()


def test_a_link_that_leads_to_a_port_is_that_port(tmp_path) -> None:
    by_name = tmp_path / "observer"
    by_name.symlink_to("/dev/ttyUSB0")
    tree = team_file()
    tree["robots"]["picket_0"]["link"]["port"] = str(by_name)
    with pytest.raises(ConfigError, match="another address than that of observer_0's link"):
        load_deployment(tree)


def test_two_nodes_in_one_namespace_are_one_robot() -> None:
    settings = [ZumyRos1Settings("zumy_ros1", master) for master in ("http://robot:11311", "http://robot:11311/")]
    assert addresses_of(settings[0]) == addresses_of(settings[1]) == ("http://robot:11311 /zumy1",)


def test_a_file_that_is_none(tmp_path) -> None:
    broken, binary = tmp_path / "broken.yaml", tmp_path / "binary.yaml"
    broken.write_text("team: [surveyors\n")
    binary.write_bytes(b"\xd0\xff")
    for path, expected in [
        (tmp_path / "none.yaml", "expected a team file (.yaml) that exists"),
        (tmp_path, "expected a team file (.yaml) that exists"),
        (broken, "expected valid YAML"),
        (binary, "expected a text file that can be read"),
    ]:
        with pytest.raises(ConfigError) as refusal:
            load_deployment(path)
        assert expected in str(refusal.value)
