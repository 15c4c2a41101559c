"""Delay, loss and noise do what they say, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from coop_envs.actions import hold_action
from coop_envs.errors import ConfigError
from coop_envs.observations import MATE_FIELDS, SELF_FIELDS
from coop_envs.wrappers import ActionDelay, MessageLoss, NoiseSettings, ObservationNoise
from coop_envs.wrappers.action_delay import DelayLine
from coop_envs.wrappers.message_loss import LastReceived
from coop_envs.wrappers.observation_noise import Noise
from tests.environment.policies import random_actions
from tests.wrappers.stacks import team

ALL = np.ones(1000, dtype=bool)
SELF = {field.name: k for k, field in enumerate(SELF_FIELDS)}
MATE = {field.name: k for k, field in enumerate(MATE_FIELDS)}


def made_up(teams: int, robots: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Observations of the right shapes: every robot has two mates."""
    own = rng.normal(size=(teams, robots, len(SELF_FIELDS))).astype(np.float32)
    own[..., :2] = 1.0, 0.0
    mask = np.zeros((teams, robots, 7), dtype=np.int8)
    mask[..., :2] = 1
    mates = rng.normal(size=(teams, robots, 7, len(MATE_FIELDS))).astype(np.float32) * mask[..., None]
    window = rng.integers(0, 256, (teams, robots, 3, 16, 16)).astype(np.uint8)
    return {"self": own, "mates": mates, "mask": mask, "map": window, "alive": np.ones((teams, robots), np.int8)}


@pytest.mark.parametrize("delay", [0, 1, 4])
def test_an_action_takes_effect_after_the_delay(delay: int) -> None:
    """The delayed team does what a team does that holds first and then is told the same."""
    rng = np.random.default_rng(0)
    plan = [dict(zip(team().possible_agents, random_actions(rng, 3), strict=True)) for _ in range(20)]
    late, plain = ActionDelay(team(), delay), team()
    late.reset(seed=1)
    plain.reset(seed=1)
    held = [dict.fromkeys(plain.possible_agents, hold_action())] * delay
    for asked, done in zip(plan, [*held, *plan], strict=False):
        a, b = late.step(asked)[0], plain.step(done)[0]
        for name in a:
            np.testing.assert_array_equal(a[name]["self"], b[name]["self"])


def test_a_drawn_delay_is_each_of_its_values_equally_often_and_holds_for_an_episode() -> None:
    line = DelayLine(1000, 1, (2, 4))
    line.begin(ALL, seed=0)
    first = line.arrays["delay"].copy()
    assert np.bincount(first)[2:].min() > 333 - 4 * np.sqrt(1000 * 2 / 9) and set(first) == {2, 3, 4}
    line.actions(np.zeros((1000, 1, 8), dtype=np.float32))
    np.testing.assert_array_equal(line.arrays["delay"], first)
    line.moment.decisions += 1
    line.begin(half := np.arange(1000) < 500)
    assert (line.arrays["delay"] != first)[half].any()
    np.testing.assert_array_equal(line.arrays["delay"][~half], first[~half])


@pytest.mark.parametrize("missed", ["all", "mates"])
def test_what_does_not_arrive_is_what_arrived_last(missed) -> None:
    rng, loss = np.random.default_rng(0), LastReceived(1000, 0.3, missed)
    loss.begin(ALL, seed=0)
    sent = [made_up(1000, 2, rng) for _ in range(4)]
    parts = ("self", "mates", "mask", "map") if missed == "all" else ("mates", "mask")
    got, shares = loss.observations(sent[0]), []
    assert all((got[key] == sent[0][key]).all() for key in sent[0])
    for new in sent[1:]:
        loss.moment.decisions += 1
        before, got = got, loss.observations(new)
        kept = (got["mates"] == before["mates"]).all(axis=(2, 3))
        shares.append(kept.mean())
        for key in sent[0]:
            stays = kept if key in parts else np.zeros_like(kept)
            expected = np.where(stays.reshape(*stays.shape, *[1] * (new[key].ndim - 2)), before[key], new[key])
            np.testing.assert_array_equal(got[key], expected)
    assert abs(np.mean(shares) - 0.3) < 4 * np.sqrt(0.3 * 0.7 / 6000)


def test_a_radio_that_never_works_shows_the_start() -> None:
    env = MessageLoss(team(), 1.0)
    start, _ = env.reset(seed=0)
    for _ in range(10):
        seen, *_ = env.step(dict.fromkeys(env.agents, np.array([-1, 1, 0, 0, 0, 0, 0, 1], np.float32)))
        np.testing.assert_array_equal(seen["observer_0"]["self"], start["observer_0"]["self"])


def test_noise_has_its_size_in_the_entrys_unit_and_leaves_the_rest_bit_for_bit() -> None:
    settings = NoiseSettings(own={"x": 0.02, "battery": 0.0}, mates={"distance": 0.1}, map_flip=0.1)
    noise, sent = Noise(1000, settings), made_up(1000, 3, np.random.default_rng(0))
    noise.begin(ALL, seed=0)
    got = noise.observations(sent)
    own, mates = got["self"] - sent["self"], got["mates"] - sent["mates"]
    assert (np.delete(own, SELF["x"], axis=-1) == 0.0).all()
    assert (np.delete(mates, MATE["distance"], axis=-1) == 0.0).all()
    assert (mates[..., 2:, :] == 0.0).all()
    for values, sigma in ((own[..., SELF["x"]] * 2.0, 0.02), (mates[..., :2, MATE["distance"]] * 2.0, 0.1)):
        assert abs(values.mean()) < 4 * sigma / np.sqrt(values.size)
        assert abs(values.std() / sigma - 1.0) < 4 / np.sqrt(2 * values.size)
    layers = sent["map"][:, :, :2]
    flipped = got["map"][:, :, :2] != layers
    np.testing.assert_array_equal(got["map"][:, :, :2][flipped], 255 - layers[flipped])
    assert abs(flipped.mean() - 0.1) < 4 * np.sqrt(0.09 / flipped.size)
    np.testing.assert_array_equal(got["map"][:, :, 2], sent["map"][:, :, 2])
    np.testing.assert_array_equal(noise.observations(sent)["self"], got["self"])


def test_without_noise_nothing_changes() -> None:
    env, plain = ObservationNoise(team(), NoiseSettings()), team()
    a, b = env.reset(seed=0)[0], plain.reset(seed=0)[0]
    for name in a:
        for key in a[name]:
            np.testing.assert_array_equal(a[name][key], b[name][key])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ActionDelay(team(), -1), "decisions: got -1"),
        (lambda: ActionDelay(team(), (3, 2)), "decisions: got"),
        (lambda: MessageLoss(team(), 1.5), "chance: got 1.5"),
        (lambda: MessageLoss(team(), 0.5, "self"), "missed: got 'self'"),  # type: ignore[arg-type]
        (lambda: MessageLoss(team(), 0.5, stream=256), "stream: got 256"),
        (lambda: NoiseSettings(own={"bateri": 0.1}), "did you mean 'battery'"),
        (lambda: NoiseSettings(mates={"x": -0.1}), "noise.mates.x: got -0.1"),
        (lambda: NoiseSettings(map_flip=2.0), "noise.map_flip: got 2.0"),
    ],
)
def test_settings_are_checked(make, message) -> None:
    with pytest.raises(ConfigError, match=message):
        make()
