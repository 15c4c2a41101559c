"""Settings that cannot be meant are refused in one line; a fence is a rectangle or a polygon."""

from __future__ import annotations

import math

import pytest

from coop_envs.errors import ConfigError
from coop_envs.validation import validated
from hardware_bridge.safety import SafetyLimits
from hardware_bridge.safety.polygon import depth, encloses, rectangle

ELL = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0))


@pytest.mark.parametrize(
    ("data", "field"),
    [
        ({"deadman_s": 0.0}, "deadman_s"),
        ({"deadman_s": math.nan}, "deadman_s"),
        ({"deadman_ms": 400}, "deadman_ms"),
        ({"max_pose_age_s": -1.0}, "max_pose_age_s"),
        ({"barrier_margin_m": -0.01}, "barrier_margin_m"),
        ({"battery_floor": 1.0}, "battery_floor"),
        ({"battery_floor": 0.9, "battery_hysteresis": 0.2}, "battery_hysteresis"),
        ({"laser_max_on_s": 60.0}, "laser_max_on_s"),
        ({"geofence": [1.0, 0.0, 0.0, 1.0]}, "geofence"),
        ({"geofence": [[0, 0], [1, 1]]}, "geofence"),
        ({"geofence": [[0, 0], [1, 1], [2, 2]]}, "geofence"),
        ({"geofence": [[0, 0], [1, 1], [1, 0], [0, 1]]}, "geofence"),
    ],
)
def test_refuses(data, field):
    with pytest.raises(ConfigError, match=rf"^safety\.\S*{field}.*: got .*, expected .*") as error:
        validated(SafetyLimits, data, "safety")
    assert "\n" not in str(error.value)


def test_reads_both_kinds_of_fence():
    square = validated(SafetyLimits, {"geofence": [0, 0, 2, 1]}, "safety")
    assert square.corners == ((0, 0), (2, 0), (2, 1), (0, 1))
    assert validated(SafetyLimits, {"geofence": [list(corner) for corner in ELL]}, "safety").corners == ELL
    four = validated(SafetyLimits, {"geofence": [[0, 0], [1, 0], [1, 1], [0, 1]]}, "safety")
    assert four.corners == rectangle(0, 0, 1, 1)
    assert SafetyLimits().corners is None


def test_faults_stand_a_robot_within_half_a_second_with_a_tick_and_the_wire():
    limits = SafetyLimits()
    slowest = max(limits.deadman_s, limits.human_timeout_s, limits.max_sample_age_s, limits.max_pose_age_s or 0.0)
    assert slowest + 1 / 30 + 0.05 < 0.5


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((0.5, 0.5), 0.5),
        ((0.9, 0.9), math.hypot(0.1, 0.1)),  # the inner corner is nearest
        ((1.5, 1.5), -0.5),
        ((1.8, 0.5), 0.2),
        ((-3.0, -4.0), -5.0),
        ((2.0, 0.5), 0.0),
    ],
)
def test_depth_by_hand(point, expected):
    assert depth(ELL, point) == pytest.approx(expected)
    assert depth(ELL[::-1], point) == pytest.approx(expected), "the sense of turning does not matter"


def test_a_side_without_length_encloses_nothing():
    assert encloses(ELL)
    assert not encloses((*ELL, ELL[0]))
    assert not encloses((*ELL[:-1], (math.nan, 2.0)))
