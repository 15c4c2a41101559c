from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from coop_envs.errors import ConfigError
from coop_envs.mapping.swept_volume import SweptVolume, growth, pentagonal_section, round_section

RADIUS = 0.05
CIRCLE_M2 = math.pi * RADIUS**2
SECTIONS = {"round": round_section(), "many sides": round_section(sides=48), "pentagon": pentagonal_section()}


def united(rays, section=None):
    """Volume (m^3) of the union of cylinders along rays (n, 2, 3)."""
    volume = SweptVolume(section)
    volume.add(*np.swapaxes(np.asarray(rays, dtype=float), 0, 1))
    return volume.volume_m3


def fan(seed, count=12):
    """Rays from two cameras to common points, (2 count, 2, 3)."""
    points = np.random.default_rng(seed).uniform([0.8, -0.5, 0.0], [1.5, 0.5, 0.6], (count, 3))
    return np.concatenate([[(camera, point) for point in points] for camera in ([0, 0, 0.1], [1.0, 1.5, 0.1])])


def test_one_cylinder():
    slanted = [[(0.1, 0.2, 0.3), (1.1, -0.8, 0.9)]]
    length = math.sqrt(1 + 1 + 0.36)
    assert united(slanted) == pytest.approx(CIRCLE_M2 * length, rel=1e-9)
    pentagon = 5 * 0.5 * RADIUS**2 * math.sin(math.radians(72))
    assert united(slanted, pentagonal_section()) == pytest.approx(pentagon * length, rel=1e-9)
    assert pentagon / (2 * RADIUS) ** 2 == pytest.approx(0.594, abs=5e-4)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0)])
def test_cylinders_along_the_axes(direction):
    assert united([[(0, 0, 0), direction]]) == pytest.approx(CIRCLE_M2, rel=1e-9)


def test_two_crossing_cylinders_share_steinmetz_solid():
    """Turned at random about their axes, the polygons share what circles share, 16/3 r^3, to 0.1 % at 48 sides."""
    turn = Rotation.from_rotvec([0.3, 0.6, 0.9]).as_matrix()
    cross = np.array([[(-0.5, 0, 0), (0.5, 0, 0)], [(0, -0.5, 0), (0, 0.5, 0)]]) @ turn.T
    shared = {sides: 2 * CIRCLE_M2 - united(cross, round_section(sides=sides)) for sides in (12, 48)}
    assert shared[12] == pytest.approx(16 / 3 * RADIUS**3, rel=0.02)
    assert shared[48] == pytest.approx(16 / 3 * RADIUS**3, rel=0.001)


def test_disjoint_cylinders_add_up_and_the_same_one_twice_does_not():
    ray = [(0, 0, 0), (0.7, 0.1, 0.2)]
    aside = [(0, 0, 1), (0.7, 0.1, 1.2)]
    one = united([ray])
    assert united([ray, aside]) == pytest.approx(2 * one, rel=1e-9)
    assert united([ray, ray]) == pytest.approx(one, rel=1e-6)


@pytest.mark.parametrize("name", SECTIONS)
def test_the_surface_is_closed_and_bounds_the_volume(name):
    volume = SweptVolume(SECTIONS[name])
    volume.add(*np.swapaxes(fan(1, count=4), 0, 1))
    surface = trimesh.Trimesh(*volume.mesh(), process=False)
    assert surface.is_watertight
    assert surface.volume == pytest.approx(volume.volume_m3, rel=1e-9)


def test_trimeshs_union_of_its_own_cylinders_has_the_same_volume():
    rays = fan(2, count=3)
    section = round_section(sides=48)
    made = [trimesh.creation.cylinder(section.corner_m, sections=48, segment=ray) for ray in rays]
    assert united(rays, section) == pytest.approx(trimesh.boolean.union(made).volume, rel=5e-4)


@pytest.mark.parametrize("seed", range(2))
def test_drawn_points_measure_the_same_union(seed):
    """Points drawn in true cylinders, each weighed by one over the number of cylinders that hold it."""
    rng = np.random.default_rng(seed)
    start, end = fan(seed).swapaxes(0, 1)
    length = np.linalg.norm(end - start, axis=1)
    axis = (end - start) / length[:, None]
    n = 100_000
    which = rng.choice(len(start), n, p=length / length.sum())
    offset = rng.normal(size=(n, 3))
    offset -= np.sum(offset * axis[which], axis=1, keepdims=True) * axis[which]
    offset *= RADIUS * np.sqrt(rng.uniform(size=(n, 1))) / np.linalg.norm(offset, axis=1, keepdims=True)
    point = start[which] + axis[which] * (length[which] * rng.uniform(size=n))[:, None] + offset
    along = np.einsum("nki,ki->nk", point[:, None] - start, axis)
    apart = np.linalg.norm(point[:, None] - start - along[..., None] * axis, axis=2)
    held = np.sum((along >= -1e-12) & (along <= length + 1e-12) & (apart <= RADIUS + 1e-12), axis=1)
    expected = CIRCLE_M2 * length.sum() * np.mean(1 / held)
    assert united(fan(seed)) == pytest.approx(expected, rel=0.005)


def test_batches_and_their_order_do_not_matter_and_the_last_is_the_whole():
    rays = fan(3, count=4)
    start, end = rays.swapaxes(0, 1)
    one_by_one, in_threes = growth(start, end, 1), growth(start, end, 3)
    np.testing.assert_allclose(in_threes, one_by_one[[2, 5, 7]], rtol=1e-9)
    assert np.all(np.diff(one_by_one) > 0)
    assert growth(start[::-1], end[::-1], 8)[0] == pytest.approx(one_by_one[-1], rel=1e-9)
    assert one_by_one[-1] == pytest.approx(united(rays) / 0.001, rel=1e-9)


def test_nothing_swept_is_no_volume():
    assert SweptVolume().h_v == 0.0
    assert united([[(1, 2, 3), (1, 2, 3)]]) == 0.0
    assert SweptVolume().add(np.zeros((0, 3)), np.zeros((0, 3))) == 0.0


@pytest.mark.parametrize(
    ("starts", "ends", "named"),
    [
        ([[0, 0, 0]], [[1, 1, np.nan]], "finite"),
        ([[0, 0, 0]], [[1, 1, 1], [2, 2, 2]], "shape"),
        ([0, 0, 0], [1, 1, 1], "shape"),
    ],
)
def test_rays_that_are_none_are_refused(starts, ends, named):
    with pytest.raises(ConfigError, match=named):
        SweptVolume().add(starts, ends)


def test_a_section_needs_a_diameter_and_three_sides():
    with pytest.raises(ConfigError, match="diameter_m"):
        round_section(diameter_m=0.0)
    with pytest.raises(ConfigError, match="sides"):
        round_section(sides=2)
