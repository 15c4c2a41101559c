"""Networks, observations and policy files for the tests of this room."""

from __future__ import annotations

import functools
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor

from coop_envs.agents.catalog import load_team
from coop_envs.observations import MATE_SIZE, MATES, SELF_SIZE, WINDOW
from coop_envs.policy import Observations, TeamDescription
from coop_envs.scenario import load_scenario
from policies.description import METADATA_KEY, PolicyDescription, describe_policy
from policies.export import export
from policies.networks import NetworkSettings, TeamActorCritic
from policies.onnx_policy import DOCKED

DECISION_S, CELL_M = 0.2, 0.05


def rows(count: int, seed: int = 0) -> dict[str, NDArray[Any]]:
    """Observations (count, ...) of observers and pickets in turns; row k has k mates, up to all."""
    rng = np.random.default_rng(seed)
    own = rng.normal(size=(count, SELF_SIZE)).astype(np.float32)
    own[:, 0], own[:, 1] = np.arange(count) % 2 == 0, np.arange(count) % 2 == 1
    own[:, DOCKED] = 0.0
    yaw = rng.uniform(-np.pi, np.pi, count)
    own[:, 5], own[:, 6] = np.cos(yaw), np.sin(yaw)
    return {
        "self": own,
        "mates": rng.normal(size=(count, MATES, MATE_SIZE)).astype(np.float32),
        "mask": (np.arange(MATES) < np.arange(count)[:, None]).astype(np.int8),
        "map": rng.integers(256, size=(count, 3, WINDOW, WINDOW), dtype=np.uint8),
    }


def tensors(arrays: dict[str, NDArray[Any]]) -> dict[str, Tensor]:
    return {key: torch.from_numpy(array) for key, array in arrays.items()}


def network(kind: str = "attention", seed: int = 0, **settings: Any) -> TeamActorCritic:
    """A network far from its start, as after training, with a normaliser that has seen something."""
    torch.manual_seed(seed)
    made = TeamActorCritic(NetworkSettings(kind=kind, **settings))  # type: ignore[arg-type]
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    seen = rows(200, seed + 1)
    seen["self"] += 0.3
    made.normaliser.update(tensors(seen))
    return made


def description(settings: NetworkSettings, **values: Any) -> PolicyDescription:
    how: dict[str, Any] = {"command": "coop train --scenario arena", "seed": 7, "steps": 1000} | values
    return describe_policy("learned", load_scenario("arena"), settings, **how)


@functools.cache
def model(kind: str = "mlp") -> bytes:
    """The bytes of a policy's file."""
    made = network(kind)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.onnx"
        export(made, description(made.settings), path)
        return path.read_bytes()


def model_with(**changes: Any) -> bytes:
    """The file of a policy whose description is changed."""
    proto = onnx.load_model_from_string(model())
    data = json.loads(next(p.value for p in proto.metadata_props if p.key == METADATA_KEY)) | changes
    onnx.helper.set_model_props(proto, {METADATA_KEY: json.dumps(data)})
    return proto.SerializeToString()


def team(robots: int = 5, decision_s: float = DECISION_S, cell_m: float = CELL_M) -> TeamDescription:
    """The first robots of the scouts: an observer, then pickets."""
    members = load_team("scouts").members[:robots]
    return TeamDescription(tuple(m.name for m in members), members, cell_m, decision_s, True, time_limit_s=60.0)


def observed(names: tuple[str, ...], seed: int = 0) -> Observations:
    """Random observations of these robots."""
    arrays = rows(len(names), seed)
    return {name: {key: array[i] for key, array in arrays.items()} for i, name in enumerate(names)}
