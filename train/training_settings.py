"""Everything that decides how a policy is trained, as one validated tree with units."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from coop_envs.errors import require
from coop_envs.scenario import Scenario, load_scenario
from coop_envs.validation import STRICT
from policies.network_settings import NetworkSettings
from train.overrides import Overrides, assignments


@dataclass(frozen=True)
class PPOSettings:
    """Proximal policy optimisation."""

    __pydantic_config__ = STRICT
    learning_rate: float = 5e-4
    """Step size of Adam at the start."""
    learning_rate_decay: Literal["linear", "none"] = "linear"
    """Whether it falls to 0 over the training."""
    rollout_steps: int = 64
    """Steps of every team between updates (count)."""
    minibatch_rows: int = 4096
    """Rows (a row is one robot in one step) of one gradient step (count)."""
    epochs: int = 4
    """How often an update goes over its rows (count)."""
    gamma: float = 0.99
    """Discount of rewards per step."""
    gae_lambda: float = 0.95
    """Decay of the advantage estimator per step."""
    clip: float = 0.2
    """Largest change of a row's probability ratio that still counts."""
    entropy_coef: float = 0.003
    """Weight of the entropy (nats) in the loss."""
    value_coef: float = 0.5
    """Weight of the value's squared error in the loss."""
    max_grad_norm: float = 0.5
    """Norm to which gradients are cut."""
    target_kl: float | None = 0.05
    """An update stops at 1.5 times this divergence (nats) from the policy it started with; None: never."""

    def __post_init__(self) -> None:
        for name in ("rollout_steps", "minibatch_rows", "epochs"):
            require(getattr(self, name) >= 1, f"ppo.{name}", getattr(self, name), "1 or more")
        require(self.minibatch_rows >= 2, "ppo.minibatch_rows", self.minibatch_rows, "2 or more")
        for name in ("learning_rate", "clip", "max_grad_norm"):
            require(getattr(self, name) > 0, f"ppo.{name}", getattr(self, name), "more than 0")
        for name in ("gamma", "gae_lambda"):
            require(0 <= getattr(self, name) <= 1, f"ppo.{name}", getattr(self, name), "0 to 1")
        for name in ("entropy_coef", "value_coef"):
            require(getattr(self, name) >= 0, f"ppo.{name}", getattr(self, name), "0 or more")
        require(self.target_kl is None or self.target_kl > 0, "ppo.target_kl", self.target_kl, "more than 0, or null")


@dataclass(frozen=True)
class TrainingSettings:
    """Train an exploration policy for teams of robots; writes OUT/policy.onnx, checkpoints, curves and a report.

    One step is one decision of the policy for every robot of one team.
    """

    __pydantic_config__ = STRICT
    scenario: str = "arena"
    """A scenario's name, or its YAML file."""
    world: Path | None = None
    """A triangle mesh (.ply, .obj, .stl; metres, z up) or height map (.png) in place of the scenario's world."""
    team: str | None = None
    """A team preset's name, or its YAML file; the scenario's own if not given."""
    overrides: Overrides = ()
    """Replaces one entry of the scenario, such as task.time_limit_s=100; may be given several times."""
    steps: int = 1_000_000
    """Length of the training (steps of teams, count), rounded up to whole updates of teams x ppo.rollout_steps."""
    teams: int = 256
    """Teams that explore at the same time (count)."""
    num_worlds: int | None = None
    """Training worlds (count); the scenario's own number if not given."""
    repeat: int = 1
    """Decisions for which an action is held (count)."""
    seed: int = 0
    """Seed of weights, worlds and noise; on one CPU and with one number of threads it fixes the result."""
    out: Path = Path("out/train")
    """Folder for the outputs: new or empty, or the one of the training to go on with."""
    network: NetworkSettings = dataclasses.field(default_factory=NetworkSettings)
    """The network that is trained."""
    ppo: PPOSettings = PPOSettings()
    """How it is trained."""
    reward_scale: float = 1.0
    """Factor on rewards, for learning alone: what is reported is without it."""
    stochastic: bool = True
    """Whether the exported policy draws its actions at random, as in training, or takes the likeliest."""
    evaluate_every: int = 250_000
    """Steps between evaluations on held-out worlds (count); 0: at the end alone."""
    evaluate_episodes: int = 16
    """Episodes of one evaluation (count); 0: none."""
    threads: int | None = None
    """CPU threads for the network (count; all if not given)."""
    device: str = "cpu"
    """Where teams and network are computed: cpu or cuda:0."""

    def __post_init__(self) -> None:
        least = {"steps": 1, "teams": 1, "repeat": 1, "seed": 0, "evaluate_every": 0, "evaluate_episodes": 0}
        for name, number in least.items():
            require(getattr(self, name) >= number, name, getattr(self, name), f"{number} or more")
        for name in ("num_worlds", "threads"):
            require(getattr(self, name) is None or getattr(self, name) >= 1, name, getattr(self, name), "1 or more")
        require(self.reward_scale > 0, "reward_scale", self.reward_scale, "more than 0")
        assignments(self.overrides)

    def load_scenario(self) -> Scenario:
        """The scenario with world, team and overrides put in.

        Raises:
            ConfigError: in one line.
        """
        changes: dict[str, Any] = {"world": self.world and str(self.world), "team": self.team}
        given = {name: value for name, value in changes.items() if value is not None}
        return load_scenario(self.scenario, **given, **assignments(self.overrides))

    def plain(self) -> dict[str, Any]:
        """As plain data, from which `validated` makes the same settings."""
        tree = dataclasses.asdict(self)
        paths = {name: str(value) for name, value in tree.items() if isinstance(value, Path)}
        return tree | paths | {"overrides": list(self.overrides)}
