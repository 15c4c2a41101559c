"""A learned policy run from its file by NumPy and onnxruntime; torch is not needed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.actions import ACTION_SIZE, hold_action
from coop_envs.errors import ConfigError, CoopError, require
from coop_envs.observations import MAP_LAYERS, MATE_SIZE, MATES, SELF_FIELDS, SELF_SIZE, WINDOW
from coop_envs.policy import Actions, Observations, TeamDescription, check_needs
from policies.description import PolicyDescription, description_in

INPUTS = {
    "self": ("tensor(float)", (SELF_SIZE,)),
    "mates": ("tensor(float)", (MATES, MATE_SIZE)),
    "mask": ("tensor(int8)", (MATES,)),
    "map": ("tensor(uint8)", (len(MAP_LAYERS), WINDOW, WINDOW)),
}
OUTPUTS = {"action": (ACTION_SIZE,), "hold_probability": (), "mean": (ACTION_SIZE - 1,)}
STD = "std"


DOCKED = next(k for k, field in enumerate(SELF_FIELDS) if field.name == "docked")


class OnnxPolicy:
    """One network for all robots of a team.

    Decides every ``description.repeat`` decisions and keeps its actions in between. If it is stochastic, it draws them
    with a generator of its own; a robot's draws do not depend on who else is alive.

    Args:
        model: the bytes of a policy file.
        source: names the file in errors.

    Raises:
        ConfigError: not a policy file, or one that this version cannot run.
        CoopError: onnxruntime is missing.
    """

    def __init__(self, model: bytes, source: str) -> None:
        self._session = _open(model, source)
        metadata = self._session.get_modelmeta().custom_metadata_map
        self.description: PolicyDescription = description_in(metadata, source)
        _check_signature(self._session, source)
        self.name, self.needs = self.description.name, self.description.needs
        self._place: dict[str, int] = {}

    def reset(self, team: TeamDescription, seed: int) -> None:
        """Start an episode.

        Raises:
            ConfigError: the team lacks what the policy needs, or has another decision rate or map window.
        """
        check_needs(self, team)
        _check_same("team.decision_s", team.decision_s, self.description.decision_s, self.name)
        _check_same("team.cell_m", team.cell_m, self.description.cell_m, self.name)
        self._place = {name: i for i, name in enumerate(team.names)}
        self._rng = np.random.default_rng(seed)
        self._kept: Actions = {}
        self._left = 0

    def act(self, observations: Observations) -> Actions:
        """One action in [-1, 1] for each robot observed.

        Raises:
            CoopError: before the first reset.
        """
        if not self._place:
            raise CoopError(f"policy {self.name}: got no reset yet, expected reset() first")
        if not observations:
            return {}
        if self._left == 0 or not observations.keys() <= self._kept.keys():
            self._kept = dict(zip(observations, self._decide(observations), strict=True))
            self._left = self.description.repeat
        self._left -= 1
        return {name: self._kept[name].copy() for name in observations}

    def answers(self, rows: dict[str, NDArray[Any]], outputs: list[str] | None = None) -> list[NDArray[np.float32]]:
        """The model's ``outputs`` for stacked observations (n, ...): all of them, in order, unless told which."""
        return self._session.run(outputs or [*OUTPUTS, STD], {key: rows[key] for key in INPUTS})

    def _decide(self, observations: Observations) -> NDArray[np.float32]:
        """Actions (n, 8); robots in the dock hold, as in training: one that is let out between decisions stands."""
        rows = {key: np.stack([observation[key] for observation in observations.values()]) for key in INPUTS}
        if self.description.stochastic:
            hold, mean, std = self.answers(rows, ["hold_probability", "mean", STD])
            actions = self._draw(list(observations), hold, mean, std)
        else:
            actions = self.answers(rows, ["action"])[0]
        return rest_in_dock(actions, rows["self"])

    def _draw(
        self, names: list[str], hold: NDArray[np.float32], mean: NDArray[np.float32], std: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Actions (n, 8) at random, by draws for the whole team."""
        places = [self._place[name] for name in names]
        chance = self._rng.random(len(self._place), dtype=np.float32)[places]
        noise = self._rng.standard_normal((len(self._place), len(std)), dtype=np.float32)[places]
        return drawn(hold, mean, std, chance, noise)


def drawn(
    hold: NDArray[np.float32],
    mean: NDArray[np.float32],
    std: NDArray[np.float32],
    chance: NDArray[np.float32],
    noise: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Actions (n, 8) from what the model answers, uniform ``chance`` (n,) and standard normal ``noise`` (n, 7)."""
    holds = np.where(chance < hold, np.float32(1.0), np.float32(-1.0))
    return np.column_stack([holds, np.clip(mean + std * noise, -1.0, 1.0)]).astype(np.float32)


def rest_in_dock(actions: NDArray[np.float32], own: NDArray[np.float32]) -> NDArray[np.float32]:
    """The actions (n, 8) with a hold for robots in the dock, by their ``self`` (n, 29)."""
    return np.where(own[:, DOCKED, None] > 0, hold_action(), actions)


def _open(model: bytes, source: str) -> Any:
    try:
        import onnxruntime
    except ModuleNotFoundError:
        raise CoopError(
            f"policy {source}: got no onnxruntime, expected it installed: pip install 'coop_envs[policy]'"
        ) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # a network this small only loses by threads
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # noqa: BLE001  onnxruntime's errors share no other base
        raise ConfigError(source, f"{len(model)} bytes ({_first_line(error)})", "a policy exported to ONNX") from None


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0].rpartition(" : ")[2][:80]


def _check_signature(session: Any, source: str) -> None:
    got = {node.name: (node.type, tuple(node.shape[1:])) for node in session.get_inputs()}
    require(got == INPUTS, f"{source}: inputs", got, f"{INPUTS}")
    dynamic = all(isinstance(node.shape[0], str) for node in session.get_inputs())
    require(dynamic, f"{source}: inputs", "a fixed number of robots", "any number of robots")
    given = {node.name: tuple(node.shape[1:]) for node in session.get_outputs() if node.name != STD}
    require(given == OUTPUTS, f"{source}: outputs", given, f"{OUTPUTS}")
    std = [tuple(node.shape) for node in session.get_outputs() if node.name == STD]
    require(std == [(ACTION_SIZE - 1,)], f"{source}: outputs.{STD}", std, f"one of {ACTION_SIZE - 1} numbers")


def _check_same(field: str, got: float, trained: float, policy: str) -> None:
    same = abs(got - trained) <= 1e-6 * trained
    require(same, field, got, f"{trained:g} (policy {policy} was trained so)")
