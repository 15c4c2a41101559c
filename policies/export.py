"""From a network to a policy's file: one ONNX model with its description inside."""

from __future__ import annotations

import contextlib
import copy
import logging
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from coop_envs.errors import CoopError, require
from coop_envs.observations import MAP_LAYERS, MATE_SIZE, MATES, SELF_SIZE, WINDOW
from policies.description import PolicyDescription, metadata_of
from policies.distribution import TeamActionDistribution
from policies.networks import COS_YAW, ROLES, SIN_YAW, TeamActorCritic
from policies.onnx_policy import INPUTS, OUTPUTS, STD, OnnxPolicy

TOLERANCE = 1e-5
BATCHES = (1, 3, 13)


class _Answers(nn.Module):
    """What a policy's file answers to a batch of observations."""

    def __init__(self, network: TeamActorCritic) -> None:
        super().__init__()
        self.network = network

    def forward(self, own: Tensor, mates: Tensor, mask: Tensor, window: Tensor) -> tuple[Tensor, ...]:
        heads = self.network({"self": own, "mates": mates, "mask": mask, "map": window})
        distribution = TeamActionDistribution(heads)
        return distribution.mode(), distribution.hold_probability, heads.mean, heads.log_std.exp()


def export(network: TeamActorCritic, description: PolicyDescription, path: Path) -> None:
    """Write ``network`` as a policy's file, whole or not at all.

    Before the file takes its place, it is loaded and asked about random observations: its answers differ from the
    network's by at most 1e-5, relative to those above 1.

    Raises:
        ConfigError: the description is of another network, or a weight is not finite.
        CoopError: the file cannot be written, or its answers differ. An older file at ``path`` stays as it was.
    """
    same = description.network == network.settings
    require(same, "description.network", description.network, f"the settings of the network: {network.settings}")
    for name, tensor in network.state_dict().items():
        require(bool(torch.isfinite(tensor).all()), f"network.{name}", "numbers that are not finite", "finite numbers")
    answers = _Answers(copy.deepcopy(network).cpu().eval())
    model = _model(answers, description)
    worst = largest_difference(answers, OnnxPolicy(model, str(path)))
    if not worst <= TOLERANCE:
        raise CoopError(f"{path}: got answers that differ from the network's by {worst:.1e}, expected {TOLERANCE:.0e}")
    _write(model, path)


def _model(answers: _Answers, description: PolicyDescription) -> bytes:
    """The ONNX model, for any number of rows."""
    rows = {0: torch.export.Dim("n", min=1)}
    with _silent(), torch.no_grad():
        example = tuple(torch.from_numpy(array) for array in random_rows(2, 0).values())
        program = torch.onnx.export(
            answers,
            example,
            input_names=list(INPUTS),
            output_names=[*OUTPUTS, STD],
            dynamic_shapes=(rows,) * len(INPUTS),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    _forget_origin(model)
    onnx.helper.set_model_props(model, metadata_of(description))
    return model.SerializeToString(deterministic=True)


def _forget_origin(model: onnx.ModelProto) -> None:
    """Leave out the exporter's notes on each node: they hold file names and lines of whoever exports."""
    noted: list[Any] = [model.graph, *model.graph.node, *model.graph.value_info, *model.graph.initializer]
    for part in [*noted, *model.graph.input, *model.graph.output, *model.functions]:
        part.ClearField("metadata_props")
        part.ClearField("doc_string")


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Without the exporter's remarks on packages it does not find."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


def random_rows(rows: int, seed: int) -> dict[str, NDArray[Any]]:
    """Observations (rows, ...) to compare answers on: roles, headings and numbers of mates at random, none in row 0."""
    rng = np.random.default_rng(seed)
    own = rng.normal(size=(rows, SELF_SIZE)).astype(np.float32)
    own[:, :ROLES] = np.eye(ROLES)[rng.integers(ROLES, size=rows)]
    yaw = rng.uniform(-np.pi, np.pi, rows)
    own[:, COS_YAW], own[:, SIN_YAW] = np.cos(yaw), np.sin(yaw)
    mask = np.arange(MATES) < rng.integers(MATES + 1, size=(rows, 1))
    mask[0] = False
    mates = rng.normal(size=(rows, MATES, MATE_SIZE)).astype(np.float32)
    window = rng.integers(256, size=(rows, len(MAP_LAYERS), WINDOW, WINDOW), dtype=np.uint8)
    return {"self": own, "mates": mates, "mask": mask.astype(np.int8), "map": window}


def largest_difference(answers: nn.Module, policy: OnnxPolicy) -> float:
    """Between the network's answers and the file's, relative to those above 1; nan if one is none.

    Whether to hold is not compared where its probability is within 1e-4 of one half.
    """
    worst = [0.0]
    for seed, rows in enumerate(BATCHES):
        observed = random_rows(rows, seed)
        with torch.no_grad():
            expected = [a.numpy() for a in answers(*(torch.from_numpy(array) for array in observed.values()))]
        got = policy.answers(observed)
        torn = np.abs(got[1] - 0.5) < 1e-4
        got[0][torn, 0] = expected[0][torn, 0]
        worst += [float(np.max(np.abs(a - b) / np.maximum(1.0, np.abs(b)))) for a, b in zip(got, expected, strict=True)]
    return float(np.max(worst))


def _write(model: bytes, path: Path) -> None:
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            file.write(model)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise CoopError(f"{path}: got {error.strerror}, expected a place to write the file to") from None
