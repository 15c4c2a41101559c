"""A training from its first step to its last: learn, look at held-out worlds, keep checkpoints, write it all down."""

from __future__ import annotations

import copy
import hashlib
import random
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from stable_baselines3.common.logger import configure

from coop_envs.device import available_cpus
from coop_envs.errors import CoopError, require
from coop_envs.scenario import Scenario
from policies.description import describe_policy
from policies.export import export
from policies.loading import FILE_NAME, load
from train import training_progress as progress
from train.checkpoint import Checkpoint, cannot_write, check_same, last_good, write_checkpoint
from train.ppo import TeamPPO
from train.training_error import TrainingError
from train.training_evaluation import HeldOut, actions_of
from train.training_settings import TrainingSettings
from train.training_state import capture, identity, restore, restore_weights
from train.training_teams import make_teams
from train.training_updates import Updates

CHECKPOINT_PERIOD_S = 60.0
LOSSES = {
    "policy_loss": "train/policy_gradient_loss",
    "value_loss": "train/value_loss",
    "entropy_loss": "train/entropy_loss",
    "approx_kl": "train/approx_kl",
    "clip_fraction": "train/clip_fraction",
    "explained_variance": "train/explained_variance",
    "learning_rate": "train/learning_rate",
}
REMEMBERED = ("started", "steps", "wall_s", "evaluation_s", "steps_per_s", "training", "held_out")
Tell = Callable[[int, Mapping[str, Any]], None]
"""Called with the steps so far and the latest figures, several times a second at most."""


class Training:
    """One run of ``settings``; files go to ``settings.out``.

    Args:
        settings: what to train, and how.
        command: the command line, for those who want to repeat it.
        tell: is told how far it is.
        checkpoint: where to go on; None starts anew.

    Raises:
        ConfigError: something about the settings cannot work, or the checkpoint is of another training.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        command: str,
        *,
        tell: Tell,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        self.settings, self.command, self.tell = settings, command, tell
        self.scenario = settings.load_scenario()
        expected = identity(settings, self.scenario)
        planned = settings.steps
        if checkpoint is not None:
            check_same(checkpoint.about, expected)
            before, planned = checkpoint.about["command"], checkpoint.about["settings"]["steps"]
            require(settings.steps >= planned, "steps", settings.steps, f"{planned} or more, as it was to be")
            self.command = command = before if command in before else f"{before}; {command}"
        threads = settings.threads or available_cpus()
        torch.set_num_threads(threads)
        self.teams = make_teams(settings, self.scenario, threads)
        self.robots = self.teams.shape[1]
        self.model = TeamPPO(self.teams, settings.network, settings.ppo, seed=settings.seed, device=settings.device)
        self._held_out = make_held_out(settings, self.scenario, threads)
        extended = checkpoint is not None and (checkpoint.about["extended"] or settings.steps > planned)
        self._about = {**expected, "settings": settings.plain(), "command": command, "extended": extended}
        self.document = progress.new_document(command, settings.plain())
        self.document["extended"] = extended
        self._fresh, self._evaluated_at = checkpoint is None, 0
        if checkpoint is not None:
            self._recall(restore(self.model, self.teams, checkpoint))
        self._before_s, self._started_at = self.document["wall_s"], time.monotonic()
        self._written_at = float("-inf")
        self._good: Checkpoint | None = checkpoint
        self._good_file = checkpoint.path if checkpoint is not None else None

    @property
    def steps(self) -> int:
        """Steps of teams so far."""
        return self.model.num_timesteps // self.robots

    @property
    def folder(self) -> Path:
        """Where checkpoints go."""
        return self.settings.out / "checkpoints"

    def run(self) -> str:
        """Train to the end, or to Ctrl-C: complete or interrupted. The files are written either way.

        Raises:
            TrainingError: something is not finite, or cannot be written; the last good checkpoint stays.
        """
        try:
            self._prepare_folder()
            status = self._learn()
            self._finish(status)
        except (CoopError, OSError) as error:
            progress.close(self.document, "failed")
            failure = TrainingError(self._what_failed(error))
            with suppress(OSError):
                progress.write(self.document, self.settings.out / "progress.json")
            raise failure from error
        return status

    def _what_failed(self, error: CoopError | OSError) -> str:
        """One line on an error; unless it was in writing, the last good state is written first."""
        if isinstance(error, OSError):
            return cannot_write(Path(str(error.filename or self.settings.out)), error, self._good_file)
        if isinstance(error.__cause__, OSError):
            return str(error)
        self._keep()
        return f"step {self.steps}: {error}; {last_good(self._good_file)}"

    def _prepare_folder(self) -> None:
        self.settings.out.mkdir(parents=True, exist_ok=True)
        if self._fresh:
            shutil.rmtree(self.settings.out / "tensorboard", ignore_errors=True)
        text = yaml.safe_dump(self.settings.plain(), sort_keys=False)
        (self.settings.out / "training.yaml").write_text(f"# {self.command}\n{text}", encoding="utf-8")
        self.model.set_logger(configure(str(self.settings.out / "tensorboard"), ["tensorboard"]))

    def _learn(self) -> str:
        left = self.settings.steps * self.robots - self.model.num_timesteps
        if left <= 0:
            return "complete"
        try:
            if self._evaluation_is_due():  # the one that the part before was interrupted in
                self._evaluate()
                self.model.logger.dump(self.steps)
            self.model.learn(left, Updates(self), log_interval=None, reset_num_timesteps=self._fresh)  # pyright: ignore[reportArgumentType]
        except KeyboardInterrupt:
            return "interrupted"
        return "complete"

    def note_state(self) -> None:
        """Keep the present state, between two updates, in memory: what training goes on from after any end."""
        self._clock()
        self._good = capture(self.model, self.teams, self._about, self.document)

    def after_update(self, rollout: Mapping[str, Any]) -> None:
        """Note an update's figures, evaluate if it is time, and write a checkpoint if it is time."""
        self.document["steps"] = self.steps
        progress.add_row(self.document, self._row(rollout))
        self.note_state()
        if self._evaluation_is_due():
            self._evaluate()
            self.note_state()
        self.model.logger.dump(self.steps)
        if time.monotonic() - self._written_at >= CHECKPOINT_PERIOD_S:
            self._keep()

    def _evaluation_is_due(self) -> bool:
        """Whether a multiple of ``evaluate_every`` lies behind the last evaluation that was carried through."""
        every = self.settings.evaluate_every
        return every > 0 and self.steps // every > self._evaluated_at // every

    def _row(self, rollout: Mapping[str, Any]) -> dict[str, Any]:
        """The figures of the last rollout and update, which go to tensorboard too."""
        logged = self.model.logger.name_to_value
        losses = {name: float(logged[key]) for name, key in LOSSES.items() if key in logged}
        losses["entropy"] = -losses.pop("entropy_loss")
        losses["std"] = float(self.model.policy.network.log_std.detach().exp().mean())
        for name, value in rollout.items():
            for key, number in value.items() if isinstance(value, Mapping) else [("", value)]:
                if number is not None:
                    self.model.logger.record(f"rollout/{name}{key and '/'}{key}", number)
        self.model.logger.record("train/std", losses["std"])
        self._clock()
        return {"steps": self.steps, "wall_s": self.document["wall_s"], **rollout, **losses}

    def _evaluate(self) -> None:
        """Export the policy, and run the file in held-out worlds; nothing that training draws from is touched."""
        began = time.monotonic()
        with _random_untouched():
            self._export()
            if self._held_out is not None:
                policy = load(self.settings.out / FILE_NAME)
                figures = self._held_out.evaluate(actions_of(policy, self._held_out.env.num_envs * self.robots))
                self._clock()
                self.document["held_out"].append({"steps": self.steps, "wall_s": self.document["wall_s"], **figures})
                for name, value in figures.items():
                    self.model.logger.record(f"held_out/{name}", value)
        self._evaluated_at = self.steps
        self.document["evaluation_s"] += time.monotonic() - began
        progress.write(self.document, self.settings.out / "progress.json")

    def _export(self) -> None:
        settings = self.settings
        description = describe_policy(
            settings.out.absolute().name,
            self.scenario,
            settings.network,
            command=self.command,
            seed=settings.seed,
            steps=self.model.num_timesteps,
            repeat=settings.repeat,
            stochastic=settings.stochastic,
        )
        export(self.model.policy.network, description, settings.out / FILE_NAME)

    def _keep(self) -> None:
        """Write the last good state."""
        if self._good is None:
            return
        steps = self._good.state["rows"] // self.robots
        self._good_file = write_checkpoint(self.folder, steps, self._good, self._good_file)
        progress.write(self.document, self.settings.out / "progress.json")
        self._written_at = time.monotonic()

    def _recall(self, history: Mapping[str, Any]) -> None:
        """Go back to what was known at a checkpoint."""
        self.document |= {name: history[name] for name in REMEMBERED}
        self._evaluated_at = max((row["steps"] for row in self.document["held_out"]), default=0)

    def _finish(self, status: str) -> None:
        """Write what the last good state amounts to: of an interrupted training, what came after it is dropped."""
        if self._good is not None:
            self.model.num_timesteps = self._good.state["rows"]
            restore_weights(self.model, self._good.learner)
            self._recall(copy.deepcopy(self._good.state["history"]))
            self._clock()
            self._keep()
        evaluated = [row["steps"] for row in self.document["held_out"]]
        if status == "complete" and self.steps not in evaluated:
            self._evaluate()
            self.model.logger.dump(self.steps)
            self.note_state()
            self._keep()
        else:
            self._export()
        self.document["weights_sha256"] = weights_sha256(self.model)
        progress.close(self.document, status)
        progress.write(self.document, self.settings.out / "progress.json")

    def _clock(self) -> None:
        wall_s = self._before_s + time.monotonic() - self._started_at
        self.document |= {"wall_s": wall_s, "steps_per_s": self.steps / max(wall_s, 1e-9)}

    def close(self) -> None:
        """Let go of the teams."""
        self.teams.close()
        if self._held_out is not None:
            self._held_out.close()


def make_held_out(settings: TrainingSettings, scenario: Scenario, threads: int) -> HeldOut | None:
    """The held-out episodes, unless there are to be none."""
    episodes, repeat, device = settings.evaluate_episodes, settings.repeat, settings.device
    return HeldOut(scenario, episodes, repeat, device=device, threads=threads) if episodes else None


def weights_sha256(model: TeamPPO) -> str:
    """Of all weights and of the normaliser, in the order of their names."""
    digest = hashlib.sha256()
    for name, tensor in sorted(model.policy.state_dict().items()):
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


@contextmanager
def _random_untouched() -> Iterator[None]:
    """Leave the generators that training draws from as they were."""
    kept = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(kept[0])
        np.random.set_state(kept[1])  # noqa: NPY002
        torch.set_rng_state(kept[2])
