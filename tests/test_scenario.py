from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from coop_envs.agents.catalog import load_hat, names
from coop_envs.errors import ConfigError, WorldError
from coop_envs.scenario import load_scenario, scenario_names, scenario_world
from coop_envs.worlds.height_map import HeightMapGeometry
from coop_envs.worlds.mesh_file import MeshFileGeometry

EVERY = [(scenario, team) for scenario in scenario_names() for team in names("teams")]


@pytest.mark.parametrize(("name", "team"), EVERY)
@pytest.mark.parametrize("split", ["train", "heldout"])
def test_every_scenario_takes_every_team(name, team, split):
    scenario = load_scenario(name, team=team)
    world = scenario_world(scenario, split, 3)
    assert len(world.starts) == len(scenario.team.members)
    assert (world.goal is not None) is (scenario.task.success == "goal")
    assert np.isfinite(world.ground.heights_m).all()


@pytest.mark.parametrize(("name", "team"), EVERY)
def test_the_observer_and_every_picket_are_linked_by_sight_at_the_start(name, team):
    scenario = load_scenario(name, team=team)
    world = scenario_world(scenario)
    observer, place = scenario.team.members[0], world.starts[0]
    for member, start in zip(scenario.team.members[1:], world.starts[1:], strict=True):
        if not member.reserve:
            seen = max(leds_in_view(observer, place, member, start), leds_in_view(member, start, observer, place))
            assert seen >= scenario.sensing.min_leds, member.name


def leds_in_view(viewer, pose, member, start) -> int:
    """How many LEDs of a member at its start lie in the picture of a viewer's camera, on level ground."""
    camera = viewer.camera
    if camera is None or member.hat is None:
        return 0
    R_world_body, tilt = rotation_z(pose[2]), camera.pitch_down_rad
    R_body_camera = np.array([[0, -np.sin(tilt), np.cos(tilt)], [-1, 0, 0], [0, -np.cos(tilt), -np.sin(tilt)]])
    p_world_camera = np.array([*pose[:2], viewer.robot.body_height_m]) + R_world_body @ camera.position_m
    intrinsics = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    leds = np.array([led.position_m for led in member.hat.leds]) @ rotation_z(start[2]).T
    p_world_body = np.array([*start[:2], member.robot.body_height_m])
    p_leds = (leds + p_world_body - p_world_camera) @ R_world_body @ R_body_camera
    pixels = cv2.projectPoints(p_leds, np.zeros(3), np.zeros(3), intrinsics, np.array(camera.distortion))[0][:, 0]
    inside = np.all((pixels >= 0) & (pixels < [camera.width_px, camera.height_px]), axis=1)
    return int(np.sum(inside & (p_leds[:, 2] > 0)))


def rotation_z(yaw):
    return np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])


def test_overrides_are_dotted_or_nested():
    dotted = load_scenario("arena", **{"task.time_limit_s": 100, "environment.geometry.goal": (0.6, 0.5, 0.1)})
    nested = load_scenario("arena", task={"time_limit_s": 100}, environment={"geometry": {"goal": [0.6, 0.5, 0.1]}})
    assert dotted == nested
    assert dotted.task.time_limit_s == 100
    assert dotted.task.success == "goal"


def test_overrides_reach_into_the_team_by_name_and_number():
    scenario = load_scenario(
        "arena",
        **{
            "team.members.picket_0.robot.mass_kg": 0.05,
            "team.members.1.hat": "hat1",
            "team.members.0.robot": {"base": "velociroach", "mass_kg": 0.06},
        },
    )
    observer, picket = scenario.team.members[:2]
    assert picket.robot.mass_kg == 0.05
    assert picket.hat == load_hat("hat1")
    assert (observer.robot.name, observer.robot.mass_kg, observer.robot.track_m) == ("velociroach", 0.06, 0.065)


def test_another_kind_of_geometry_replaces_the_first():
    scenario = load_scenario("arena", environment={"geometry": {"kind": "flat", "goal": [0, 0, 0.2]}})
    assert scenario.environment.geometry.kind == "flat"
    assert scenario.environment.texture == "cardboard"


def test_a_scenario_is_taken_as_it_is_or_changed():
    arena = load_scenario("arena")
    assert load_scenario(arena) is arena
    changed = load_scenario(arena, team="inchworm", **{"map.ego_stride": 2})
    assert (changed.team.name, changed.map.ego_stride) == ("inchworm", 2)
    assert replace(changed, team=arena.team, map=arena.map) == arena


def test_a_world_file_replaces_the_geometry_and_makes_coverage_the_task():
    scenario = load_scenario("arena", world="somewhere/hall.ply", **{"environment.geometry.scale": 0.001})
    assert (scenario.name, scenario.task.success, scenario.team.name) == ("hall", "coverage", "surveyors")
    assert scenario.environment.geometry == MeshFileGeometry("somewhere/hall.ply", scale=0.001)
    with pytest.raises(WorldError, match=r"environment\.geometry\.path: .*a file that exists"):
        scenario_world(scenario)


def test_a_png_is_a_height_map():
    scenario = load_scenario("arena", world="somewhere/hills.PNG", **{"environment.geometry.pixel_m": 0.05})
    assert scenario.environment.geometry == HeightMapGeometry("somewhere/hills.PNG", pixel_m=0.05)
    assert (scenario.name, scenario.task.success, scenario.team.name) == ("hills", "coverage", "surveyors")
    assert load_scenario("arena", world="hills.png", team="scouts").team.name == "scouts"


def test_a_scenario_is_read_from_a_file(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "name: mine\ndescription: d\nteam: surveyors\nreward: {goal: 1e1}\n"
        "environment: {medium: water, particulate: 0.1, geometry: {kind: arena, trap_size_m: [0, 0]}}\n"
    )
    scenario = load_scenario(file)
    world = scenario_world(scenario)
    assert scenario.reward.goal == 10.0
    assert world.hazards == ()
    assert world.medium.particulate == 0.1
    assert world.medium.absorption_1_m[0] > world.medium.absorption_1_m[2]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"tsk": {}}, r"^tsk: .*did you mean 'task'"),
        ({"task.time_limit": 3}, r"^task\.time_limit: .*did you mean 'time_limit_s'"),
        ({"task.time_limit_s": "10 min"}, r"^task\.time_limit_s: got '10 min', expected a number in seconds"),
        ({"task.time_limit_s": -1}, r"^task\.time_limit_s: got -1.0, expected more than 0 s"),
        ({"map.cell_m": "5 cm"}, r"^map\.cell_m: got '5 cm', expected a number in metres, without a unit"),
        ({"map.cell_m": float("nan")}, r"^map\.cell_m: got nan, expected a finite number"),
        ({"map.ego_stride": 1.5}, r"^map\.ego_stride: got 1.5, expected a whole number"),
        ({"environment.geometry.kind": "aren"}, r"^environment\.geometry: got 'aren'.*did you mean 'arena'"),
        ({"environment.geometry.trap": 1}, r"^environment\.geometry\.trap: .*trap_size_m"),
        ({"environment.geometry.goal": [1, 2]}, r"^environment\.geometry\.goal\.2: got None, expected a value"),
        ({"environment.geometry.goal": 3}, r"^environment\.geometry\.goal: got 3, expected a list"),
        ({"environment.geometry.walls": ["near"]}, r"^environment\.geometry\.walls\.0: got 'near', expected 'far', "),
        ({"environment.medium": "oil"}, r"^environment\.medium: got 'oil', expected 'air' or 'water'"),
        ({"environment": 3}, r"^environment: got 3, expected a mapping"),
        ({"environment.geometry": {"kind": "flat"}}, r"^task\.success: got 'goal', expected coverage"),
        ({"physics": "slow"}, r"^physics: got 'slow', expected"),
        ({"team": "scout"}, r"^team: .*did you mean 'scouts'"),
        ({"team": 3}, r"^team: got 3"),
        ({"team.members.99.hat": "hat0"}, r"^team\.members\.99: .*0 to 12"),
        ({"team.members.picket_0.hat": "hat9"}, r"^team\.members\.1\.hat: .*hat0"),
        ({"fidelity": "poses2"}, r"^fidelity: got 'poses2', expected 'poses' or 'features'"),
        ({"sensing.calibration.focal_share": 0.5}, r"^sensing\.calibration\.focal_share: got 0\.5, expected 0 to 0\.2"),
        ({"sensing": {"calibration": {"hat_m": -0.1}}}, r"^sensing\.calibration\.hat_m: got -0\.1"),
        ({"sensing": {"calibration": {"hat_mm": 1}}}, r"^sensing\.calibration\.hat_mm: .*did you mean 'hat_m'"),
        ({"sensing.false_lights": 9}, r"^sensing\.false_lights: got 9\.0, expected 0 to 4 a frame"),
        ({"sensing.hue_tolerance_deg": 0}, r"^sensing\.hue_tolerance_deg: got 0"),
        ({"sensing.blob_dropout": 1.0}, r"^sensing\.blob_dropout: got 1"),
        ({"sensing.merge_px": -1}, r"^sensing\.merge_px: got -1"),
    ],
)
def test_bad_entries_are_refused_in_one_line(overrides, message):
    with pytest.raises(ConfigError, match=message) as caught:
        load_scenario("arena", **overrides)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: [", "valid YAML"),
        ("just text", "a mapping"),
        ("name: x\nteam: scouts\n", r"^description: got None|^environment: got None"),
        ("name: x\ndescription: d\nenvironment: {geometry: {kind: arena}}\n", r"^team: "),
        ("name: x\ndescription: d\nteam: scouts\nenvironment: {geometry: {}}\n", "an entry 'kind'"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, text, message):
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_scenario(file)
    assert "\n" not in str(caught.value)


def test_a_scenario_can_be_changed_again():
    scenario = load_scenario("arena")
    changed = load_scenario(scenario, fidelity="features")
    assert changed.fidelity == "features" and changed.team == scenario.team
    assert len({member.hat for member in changed.team.members}) == len(changed.team.members)


def test_unknown_scenarios_are_refused():
    with pytest.raises(ConfigError, match=r"^scenario: got 'aren'.*arena, building, corner, .*; did you mean 'arena'"):
        load_scenario("aren")
    with pytest.raises(ConfigError, match="a file that exists"):
        load_scenario("nowhere.yaml")


def test_a_start_of_a_members_own_is_kept_and_checked():
    assert scenario_world(load_scenario("arena", **{"team.members.1.start": [0.1, 0.1, 1.0]})).starts[1] == (
        0.1,
        0.1,
        1.0,
    )
    with pytest.raises(WorldError, match=r"^team\.picket_0\.start: got \(0.4, 0.3, 0.0\)"):
        scenario_world(load_scenario("arena", **{"team.members.1.start": [0.4, 0.3, 0.0]}))


def test_reading_a_scenario_imports_nothing_heavy():
    code = (
        "import sys; from coop_envs.scenario import load_scenario; load_scenario('arena');"
        "print([m for m in ('torch', 'cv2', 'matplotlib', 'trimesh', 'scipy', 'warp') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_robots_may_not_jump_over_walls_between_substeps() -> None:
    with pytest.raises(ConfigError, match=r"rates\.substeps: got 1, expected enough that .* moves at most 0\.035 m"):
        load_scenario("arena", rates={"tick_s": 0.2, "substeps": 1})
