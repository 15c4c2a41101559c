from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.errors import ConfigError, WorldError
from coop_envs.worlds.arena import ArenaGeometry, RandomArenaGeometry
from coop_envs.worlds.build import Split, build_world, world_seed
from coop_envs.worlds.truth import hazard_margin_m, safe_path_exists
from tests.worlds.builders import OBSERVER, team_of

indices = st.integers(0, 2**40)
splits = st.sampled_from(["train", "heldout"])


def height_at(world, x, y):
    ground = world.ground
    i, j = (round((p - o) / ground.cell_m) for p, o in zip((x, y), ground.origin_m, strict=True))
    return float(ground.heights_m[i, j])


def test_the_arena_of_chapter_2():
    world = build_world(ArenaGeometry(), team_of(1, reserves=3))
    assert world.starts[0] == pytest.approx((-0.25, 0.30, 0.0))
    assert world.starts[1] == pytest.approx((-0.05, 0.30, 0.0))
    assert all(start == world.dock for start in world.starts[2:])
    for x, y, height in [
        (0.74, 0.3, 0.0),
        (0.76, 0.3, 0.3),
        (0.3, 0.59, 0.0),
        (0.3, 0.61, 0.3),
        (0.3, -0.01, 0.04),
        (-0.2, 0.61, 0.04),
        (-0.46, 0.3, 0.04),
        (-0.44, 0.3, 0.0),
        (0.0, 0.3, 0.0),
    ]:
        assert height_at(world, x, y) == pytest.approx(height), (x, y)
    assert world.hazards[0].signed_distance_m(np.array([0.46, 0.30])) == pytest.approx(0.01)


def test_more_pickets_move_the_observer_back_and_deepen_the_bay():
    world = build_world(ArenaGeometry(), team_of(2))
    xs = [x for x, _, _ in world.starts]
    assert xs[1:] == pytest.approx([-0.05, -0.05])
    assert xs[0] < -0.4
    assert world.ground.bounds_m[0] < xs[0] - 0.2


@pytest.mark.parametrize("pickets", range(7))
def test_teams_up_to_seven_fit_in_the_arena(pickets):
    assert len(build_world(ArenaGeometry(), team_of(pickets)).starts) == pickets + 1


@given(indices, splits)
@settings(max_examples=30, deadline=None)
def test_random_arenas_have_clear_starts_and_a_safe_path(index, split):
    world = build_world(RandomArenaGeometry(), team_of(2), split=split, index=index)
    assert safe_path_exists(world, OBSERVER.body_radius_m, OBSERVER.contact_radius_m, OBSERVER.max_step_m)
    starts = np.array(world.starts)[:, :2]
    assert np.all(hazard_margin_m(world.hazards, starts, 0.05) >= 0)
    assert 1 <= len(world.hazards) <= 4


def test_same_index_same_arena_and_other_index_another():
    def build(index: int, split: Split = "train"):
        return build_world(RandomArenaGeometry(), team_of(1), split=split, index=index)

    assert build(3).hazards == build(3).hazards
    assert np.array_equal(build(3).ground.heights_m, build(3).ground.heights_m)
    assert len({build(i, s).goal for i in range(20) for s in ("train", "heldout")}) == 40


@given(indices, indices)
def test_training_and_held_out_seeds_are_apart_by_their_last_bit(a, b):
    assert world_seed("train", a) % 2 == 0
    assert world_seed("heldout", b) % 2 == 1


def test_knobs_are_obeyed():
    geometry = RandomArenaGeometry(
        size_x_m=(1.0, 1.0),
        size_y_m=(0.8, 0.8),
        outer_walls=(0, 0),
        inner_walls=(0, 0),
        hazards=(3, 3),
        hazard_size_m=(0.1, 0.1),
        hazard_kinds=("hole",),
    )
    world = build_world(geometry, team_of(1))
    assert [h.kind for h in world.hazards] == ["hole"] * 3
    assert world.ground.bounds_m[2:] == pytest.approx((1.05, 0.85))
    assert world.ground.heights_m.max() == pytest.approx(geometry.kerb_height_m)
    assert {max(h.radius_m, *h.half_size_m) for h in world.hazards} == {0.05}


def test_an_arena_full_of_hazards_is_refused():
    crowded = RandomArenaGeometry(hazards=(20, 20), hazard_size_m=(0.5, 0.5), hazard_kinds=("trap",))
    with pytest.raises(WorldError, match=r"environment\.geometry\.hazards: got .* safe path"):
        build_world(crowded, team_of(1))


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ({"start": (0.72, 0.3, 0.0)}, "observer_0.* expected 0.07 m or more to walls"),
        ({"start": (0.80, 0.3, 0.0)}, "observer_0.* to walls"),
        ({"start": (0.2, 0.3, 0.0)}, "picket_0.* outside every trap"),
        ({"start": (3.0, 0.3, 0.0)}, "observer_0.* here z nan m"),
        ({"goal": (2.0, 0.3, 0.1)}, "geometry.goal"),
        ({"goal": (0.775, 0.3, 0.1)}, "geometry.goal"),
    ],
)
def test_starts_and_goals_out_of_place_are_refused(geometry, message):
    with pytest.raises(WorldError, match=message) as caught:
        build_world(ArenaGeometry(**geometry), team_of(1))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "fields",
    [
        {"size_m": (0.1, 0.6)},
        {"size_m": (float("nan"), 0.6)},
        {"cell_m": 0.1},
        {"kerb_height_m": 0.5},
        {"goal": (0.6, 0.3, 0.0)},
    ],
)
def test_impossible_arenas_are_refused(fields):
    with pytest.raises(ConfigError, match=rf"environment\.geometry\.{next(iter(fields))}"):
        ArenaGeometry(**fields)


@pytest.mark.parametrize("fields", [{"hazards": (4, 1)}, {"size_x_m": (0.1, 1.0)}, {"outer_walls": (0, 4)}])
def test_impossible_ranges_are_refused(fields):
    with pytest.raises(ConfigError, match=r"environment\.geometry\."):
        RandomArenaGeometry(**fields)
