"""RLlib trains: on a local cluster with the real environment, and in the sacrifice game for the right reason."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
import ray

from coop_envs.errors import ConfigError
from coop_envs.scenario import load_scenario
from tests.test_documents import ROOT, blocks
from tests.train.rllib_games import make_sacrifice
from tests.train.sacrifice_game import BEST, MEMBERS
from train.rllib_training import RllibSettings, algorithm, cluster, iteration, ppo_config, train_with_rllib


def weights(algorithm) -> dict[str, np.ndarray]:
    state = {role: algorithm.get_module(role).get_state() for role in ("observer", "picket")}
    return {f"{role}.{name}": np.array(value) for role, part in state.items() for name, value in part.items()}


@pytest.mark.slow
def test_two_workers_train_one_network_a_role(tmp_path) -> None:
    scenario = load_scenario("arena", team="inchworm", fidelity="poses", **{"task.time_limit_s": 6.0})
    settings = RllibSettings(decisions=240, minibatch_rows=128, epochs=2, hidden=(32, 32))
    past: list[dict[str, np.ndarray]] = []

    def watch(algorithm, _iteration) -> None:
        assert algorithm.env_runner_group.num_healthy_remote_workers() == 2
        past.append(weights(algorithm))

    course = train_with_rllib(scenario, 2, settings, tmp_path / "checkpoint", watch)
    assert [one.decisions for one in course] == [240, 480]
    assert all(one.team_return is not None and math.isfinite(one.team_return) for one in course)
    assert {name.split(".")[0] for name in past[0]} == {"observer", "picket"}
    for role in ("observer", "picket"):
        changed = [(past[0][name] != past[1][name]).any() for name in past[0] if name.startswith(role)]
        assert any(changed) and all(np.isfinite(value).all() for value in past[1].values())
    assert list((tmp_path / "checkpoint").iterdir())
    assert not ray.is_initialized()


@pytest.mark.slow
@pytest.mark.parametrize(("posthumous", "learned"), [(True, BEST), (False, 0.0)])
def test_a_picket_learns_to_give_itself_up_only_with_posthumous_credit(posthumous: bool, learned: float) -> None:
    settings = RllibSettings(
        env_runners=0,
        teams_per_runner=16,
        decisions=128,
        minibatch_rows=128,
        epochs=6,
        learning_rate=2e-2,
        hidden=(16,),
        gamma=1.0,
    )
    config = ppo_config(settings, make_sacrifice, {"posthumous": posthumous}, MEMBERS)
    with cluster(1), algorithm(config) as ppo:
        returns = [iteration(k, ppo.train(), "observer_0").team_return or 0.0 for k in range(12)]
    assert abs(np.mean(returns[-3:]) - learned) < 0.8, returns


@pytest.mark.parametrize(("field", "value"), [("env_runners", -1), ("decisions", 0), ("learning_rate", 0.0)])
def test_settings_are_checked(field: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"^rllib\.{field}: got"):
        RllibSettings(**{field: value})  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_documented_training_runs() -> None:
    (program,) = (block for block in blocks("docs/training_libraries.md", "python") if "rllib" in block)
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split()[0] == "240"
