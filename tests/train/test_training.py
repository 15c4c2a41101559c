"""A training can be killed at any time and goes on as if nothing had been; what goes wrong is told in one line."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from coop_envs.cli import guarded
from policies.loading import load
from train import checkpoint as checkpoint_module
from train.checkpoint import checkpoints
from train.ppo import TeamPPO
from train.team_vec_env import TeamVecEnv
from train.train import main
from train.training_evaluation import HeldOut

SMALL = [
    *("--team", "inchworm", "--set", "task.time_limit_s=10", "--teams", "8", "--threads", "1", "--num-worlds", "1"),
    *("--network.kind", "mlp", "--network.width", "16", "--network.depth", "1", "--evaluate-episodes", "0"),
    *("--ppo.rollout-steps", "8", "--ppo.minibatch-rows", "64", "--ppo.epochs", "2", "--preset", "arena"),
]
UPDATE = 8 * 8  # steps
TOTAL = 6 * UPDATE
EAGER = "import train.training; train.training.CHECKPOINT_PERIOD_S = 0.0; from train.train import main"


def small(out: Path, *more: str, steps: int = TOTAL) -> list[str]:
    return [*SMALL, "--steps", str(steps), "--out", str(out), *more]


def document(out: Path) -> dict[str, Any]:
    return json.loads((out / "progress.json").read_text())


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("trained") / "run"
    assert main(small(out)) == 0
    return out


@pytest.fixture
def eager(monkeypatch):
    """A checkpoint after every update."""
    monkeypatch.setattr("train.training.CHECKPOINT_PERIOD_S", 0.0)


def test_it_writes_what_it_promises(trained):
    told = document(trained)
    assert told["status"] == "complete"
    assert told["steps"] == TOTAL
    assert len(told["training"]) == 6
    assert {"return", "policy_loss", "value_loss", "entropy", "approx_kl", "reward_per_s"} <= set(told["training"][-1])
    settings = yaml.safe_load((trained / "training.yaml").read_text())
    assert settings == told["settings"]
    assert settings["overrides"][-1] == "task.time_limit_s=10"
    policy = load(trained)
    assert policy.description.steps == TOTAL * 3
    assert policy.description.repeat == settings["repeat"]
    assert list((trained / "tensorboard").iterdir())
    assert "coop train" in (trained / "report.html").read_text()


def test_one_seed_has_one_result(trained, tmp_path):
    assert main(small(tmp_path / "again")) == 0
    assert main(small(tmp_path / "other", "--seed", "1", steps=UPDATE)) == 0
    again, other = document(tmp_path / "again"), document(tmp_path / "other")
    assert again["weights_sha256"] == document(trained)["weights_sha256"] != other["weights_sha256"]


@pytest.mark.slow
def test_its_own_settings_file_repeats_it(trained, tmp_path):
    assert main(["--config", str(trained / "training.yaml"), "--out", str(tmp_path / "again")]) == 0
    assert document(tmp_path / "again")["weights_sha256"] == document(trained)["weights_sha256"]


def test_killed_and_resumed_ends_with_the_same_weights(trained, tmp_path):
    out = tmp_path / "run"
    program = f"{EAGER}; main({small(out)!r})"
    process = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE)
    until = time.monotonic() + 120
    while len(checkpoints(out / "checkpoints")) < 2:
        assert process.poll() is None, process.stderr and process.stderr.read().decode()
        assert time.monotonic() < until
        time.sleep(0.002)
    process.kill()
    process.wait()
    assert document(out)["status"] == "running"
    assert main(["--resume", "--out", str(out)]) == 0
    told, whole = document(out), document(trained)
    assert load(out).description.command.endswith(f"; coop train --resume --out {out}")
    assert told["weights_sha256"] == whole["weights_sha256"]
    assert [row["steps"] for row in told["training"]] == [row["steps"] for row in whole["training"]]
    assert [row["value_loss"] for row in told["training"]] == [row["value_loss"] for row in whole["training"]]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupts_keep_the_last_update_and_say_how_to_go_on(trained, tmp_path, monkeypatch, capsys, number):
    out = tmp_path / "run"
    update, done = TeamPPO.train, []

    def interrupted(self: TeamPPO) -> None:
        if len(done) == 3:
            os.kill(os.getpid(), number)
        update(self)
        done.append(self.num_timesteps)

    monkeypatch.setattr(TeamPPO, "train", interrupted)
    before = signal.getsignal(number)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
    assert main(small(out)) == 130
    signal.signal(number, before)
    monkeypatch.undo()
    told = document(out)
    assert told["status"] == "interrupted"
    assert told["steps"] == 3 * UPDATE
    assert load(out).description.steps == 3 * UPDATE * 3
    assert "coop train --resume" in capsys.readouterr().err.replace("\n", " ")
    assert main(["--resume", "--out", str(out)]) == 0
    assert document(out)["weights_sha256"] == document(trained)["weights_sha256"]


@pytest.mark.slow
def test_a_damaged_checkpoint_falls_back_to_the_one_before(trained, tmp_path, capsys, eager):
    out = tmp_path / "run"
    assert main(small(out, steps=3 * UPDATE)) == 0
    before, newest = checkpoints(out / "checkpoints")
    data = newest.read_bytes()
    newest.write_bytes(data[: len(data) // 2])
    capsys.readouterr()
    assert main(["--resume", "--out", str(out), "--steps", str(TOTAL)]) == 0
    told = capsys.readouterr().err
    assert newest.name in told
    assert "damaged" in told
    assert before.name in told.replace("\n", "")
    assert document(out)["steps"] == TOTAL


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--team", "scouts"], "team"),
        (["--network.width", "32"], "network.width"),
        (["--set", "reward.goal=1"], "scenario.reward.goal"),
        (["--seed", "5"], "seed"),
        (["--steps", str(TOTAL - 1)], "steps"),
        (["--reward-scale", "2"], "reward_scale"),
    ],
)
def test_a_checkpoint_of_another_training_is_refused(trained, arguments, named, capsys):
    before = document(trained)
    assert guarded(lambda: main(["--resume", "--out", str(trained), *arguments])) == 2
    assert_one_line(capsys, named)
    assert document(trained) == before


@pytest.mark.parametrize(("entry", "value"), [("version", "0.0.1"), ("actions", ["hold"]), ("format", 99)])
def test_a_checkpoint_of_another_version_is_refused(trained, tmp_path, entry, value, capsys, monkeypatch):
    read = checkpoint_module.read_checkpoint
    if entry == "format":
        monkeypatch.setattr(checkpoint_module, "FORMAT", value)
    else:
        aged = read(checkpoints(trained / "checkpoints")[-1])
        aged.about[entry] = value
        monkeypatch.setattr(checkpoint_module, "read_checkpoint", lambda path: aged)
    assert guarded(lambda: main(["--resume", "--out", str(trained)])) == 2
    assert_one_line(capsys, entry)


def test_a_reward_that_is_not_finite_stops_with_one_line(tmp_path, capsys, monkeypatch, eager):
    out = tmp_path / "run"
    check, calls = TeamVecEnv._check, []

    def poisoned(self: TeamVecEnv, reward: Any) -> None:
        calls.append(0)
        check(self, np.where(len(calls) > 100, np.nan, reward))

    monkeypatch.setattr(TeamVecEnv, "_check", poisoned)
    assert guarded(lambda: main(small(out))) == 2
    assert_one_line(capsys, "reward of team 0: got nan")
    monkeypatch.undo()
    assert goes_on(out)


def test_an_interrupted_evaluation_is_made_up_for(tmp_path, monkeypatch):
    out, evaluate, calls = tmp_path / "run", HeldOut.evaluate, []

    def interrupted(self: HeldOut, act: Any) -> dict[str, Any]:
        calls.append(0)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return evaluate(self, act)

    monkeypatch.setattr(HeldOut, "evaluate", interrupted)
    more = ["--evaluate-episodes", "1", "--evaluate-every", str(UPDATE)]
    assert main(small(out, *more, steps=3 * UPDATE)) == 130
    assert [row["steps"] for row in document(out)["held_out"]] == [UPDATE]
    assert main(["--resume", "--out", str(out)]) == 0
    assert [row["steps"] for row in document(out)["held_out"]] == [UPDATE, 2 * UPDATE, 3 * UPDATE]


@pytest.mark.parametrize("what", ["gradient", "loss"])
def test_numbers_that_are_not_finite_never_reach_the_weights(what, tmp_path, capsys, monkeypatch, eager):
    out = tmp_path / "run"
    update, done = TeamPPO.train, []

    def poisoned(self: TeamPPO) -> None:
        done.append(0)
        if len(done) == 3 and what == "loss":
            self.policy.network.log_std.data[1] = np.nan
        if len(done) == 3 and what == "gradient":
            self.policy.network.log_std.register_hook(lambda gradient: gradient * np.inf)
        update(self)

    monkeypatch.setattr(TeamPPO, "train", poisoned)
    assert guarded(lambda: main(small(out))) == 2
    assert_one_line(capsys, f"{what}: got")
    kept = checkpoint_module.read_checkpoint(checkpoints(out / "checkpoints")[-1])
    assert all(bool(torch.isfinite(tensor).all()) for tensor in kept.learner["policy"].values())
    monkeypatch.undo()
    assert goes_on(out)


def test_a_full_disk_stops_with_one_line_and_leaves_the_last_checkpoint(tmp_path, capsys, monkeypatch, eager):
    out = tmp_path / "run"
    write, calls = checkpoint_module._write, []

    def full(file: Any, checkpoint: Any) -> None:
        calls.append(0)
        if len(calls) == 3:
            file.write(b"half of it")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(file, checkpoint)

    monkeypatch.setattr(checkpoint_module, "_write", full)
    assert guarded(lambda: main(small(out))) == 2
    assert_one_line(capsys, "No space left on device")
    monkeypatch.undo()
    assert not list((out / "checkpoints").glob("*.part"))
    assert len(checkpoints(out / "checkpoints")) == 2
    assert goes_on(out)


def goes_on(out: Path) -> bool:
    return main(["--resume", "--out", str(out)]) == 0 and document(out)["steps"] == TOTAL


def assert_one_line(capsys: pytest.CaptureFixture[str], named: str) -> None:
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert named in errors[0]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--scenario", "arean"], "arean"),
        (["--team", "scoots"], "scoots"),
        (["--set", "task.time_limit=5"], "time_limit"),
        (["--set", "nonsense"], "nonsense"),
        (["--preset", "arean"], "preset"),
        (["--config", "missing.yaml"], "missing.yaml"),
        (["--steps", "0"], "steps"),
        (["--teams", "many"], "many"),
        (["--ppo.gamma", "2"], "ppo.gamma"),
        (["--network.kind", "transformer"], "transformer"),
        (["--device", "cuda:7"], "cuda:7"),
        (["--resume"], "checkpoint"),
        (["--preset"], "preset"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(arguments, named, tmp_path, capsys):
    out = tmp_path / "out"
    assert guarded(lambda: main(["--out", str(out), *arguments])) == 2
    assert_one_line(capsys, named)
    assert not out.exists()


def test_an_unknown_entry_of_a_settings_file_is_named(tmp_path, capsys):
    path = tmp_path / "settings.yaml"
    path.write_text("ppo: {learning_rat: 1e-3}\n")
    assert guarded(lambda: main(["--config", str(path), "--out", str(tmp_path / "out")])) == 2
    assert_one_line(capsys, "learning_rat")


def test_a_training_is_not_overwritten(trained, capsys):
    assert guarded(lambda: main(small(trained))) == 2
    assert_one_line(capsys, "--resume")
