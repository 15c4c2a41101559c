"""Environments and wrappers for the tests of wrappers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from coop_envs import exploration_v0
from coop_envs.wrappers import (
    ActionDelay,
    DomainRandomisation,
    InchwormShield,
    MacroActions,
    MessageLoss,
    NoiseSettings,
    ObservationNoise,
    Range,
    VectorActionDelay,
    VectorInchwormShield,
    VectorMessageLoss,
    VectorObservationNoise,
)

NOISE = NoiseSettings(own={"x": 0.02, "battery": 0.1}, mates={"x": 0.02, "distance": 0.05}, map_flip=0.05)
RANGES = {"environment.friction": Range(0.4, 1.0), "sensing.pixel_noise_px": Range(0.2, 2.0, log=True)}

Wrap = Callable[[Any], Any]

DISTURBANCES: dict[str, Wrap] = {
    "delay": lambda env: ActionDelay(env, (0, 3)),
    "loss": lambda env: MessageLoss(env, 0.3),
    "noise": lambda env: ObservationNoise(env, NOISE),
    "shield": InchwormShield,
}
WRAPPERS: dict[str, Wrap] = {
    **DISTURBANCES,
    "randomised": lambda env: DomainRandomisation(env, RANGES),
    "macro": MacroActions,
}
VECTOR_FORMS: dict[str, Wrap] = {
    "delay": lambda env: VectorActionDelay(env, (0, 3)),
    "loss": lambda env: VectorMessageLoss(env, 0.3),
    "noise": lambda env: VectorObservationNoise(env, NOISE),
    "shield": VectorInchwormShield,
}


def team(**settings: Any) -> Any:
    """A short game of one team with two pickets."""
    return exploration_v0.parallel_env(
        **{"scenario": "arena", "team": "inchworm", "fidelity": "poses", "task.time_limit_s": 12.0, **settings}
    )


def wrapped(names: list[str] | tuple[str, ...], wrappers: dict[str, Wrap] = WRAPPERS, env: Any = None) -> Any:
    """An environment in wrappers, the first named innermost."""
    env = team() if env is None else env
    for name in names:
        env = wrappers[name](env)
    return env
