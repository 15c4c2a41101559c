"""What a policy's file says about itself: enough to refuse a team or a program it was not made for."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from coop_envs.actions import ACTION_NAMES
from coop_envs.errors import ConfigError, require
from coop_envs.observations import MAP_LAYERS, MATE_FIELDS, SELF_FIELDS
from coop_envs.policy import TeamNeeds
from coop_envs.validation import STRICT, validated
from policies.network_settings import NetworkSettings

if TYPE_CHECKING:
    from coop_envs.scenario import Scenario

FORMAT = 1
METADATA_KEY = "coop_envs_policy"


@dataclass(frozen=True)
class Entry:
    """One number of an input: its value in ``unit`` is the entry x ``scale``."""

    __pydantic_config__ = STRICT
    name: str
    unit: str
    scale: float


@dataclass(frozen=True)
class Input:
    """One part of an observation: the entries of ``self`` or of each mate, or the layers of the ``map``, in order."""

    __pydantic_config__ = STRICT
    name: str
    entries: tuple[Entry, ...]


@dataclass(frozen=True)
class PolicyDescription:
    """How a policy was trained and what it must be given.

    ``inputs`` are what it reads of an observation; ``actions`` the names
    of the action's entries. It decides every ``repeat`` x ``decision_s`` and reads map windows of cells of ``cell_m``.
    One that is ``stochastic`` draws its actions, else it takes the likeliest. ``scenario``, ``command``, ``seed`` and
    ``steps`` (of single robots) tell where it comes from.
    """

    __pydantic_config__ = STRICT
    format: int
    package_version: str
    name: str
    inputs: tuple[Input, ...]
    actions: tuple[str, ...]
    decision_s: float
    repeat: int
    cell_m: float
    stochastic: bool
    needs: TeamNeeds
    scenario: str
    command: str
    seed: int
    steps: int
    network: NetworkSettings

    def __post_init__(self) -> None:
        require(self.format == FORMAT, "format", self.format, f"{FORMAT}, the one that this version reads")
        require(self.name.strip() != "" and self.name.isprintable(), "name", self.name, "a name in printable letters")
        positive = math.isfinite(self.decision_s) and self.decision_s > 0
        require(positive, "decision_s", self.decision_s, "above 0 s")
        require(math.isfinite(self.cell_m) and self.cell_m > 0, "cell_m", self.cell_m, "above 0 m")
        require(self.repeat >= 1, "repeat", self.repeat, "1 decision or more")
        require(self.seed >= 0, "seed", self.seed, "0 or more")
        require(self.steps >= 0, "steps", self.steps, "0 or more")
        for kind, number in asdict(self.needs).items():
            require(number >= 0, f"needs.{kind}", number, "0 or more")
        _check_inputs(self.inputs)
        require(self.actions == ACTION_NAMES, "actions", self.actions, f"{', '.join(ACTION_NAMES)}")

    def to_json(self) -> str:
        """As one line of JSON; `read_description` turns it back into an equal description."""
        return json.dumps(asdict(self))


def observed_inputs() -> tuple[Input, ...]:
    """The inputs that this version observes."""
    fields = {"self": SELF_FIELDS, "mates": MATE_FIELDS}
    named = [Input(key, tuple(Entry(f.name, f.unit, f.scale) for f in entries)) for key, entries in fields.items()]
    return (*named, Input("map", tuple(Entry(layer, "1/255", 1.0) for layer in MAP_LAYERS)))


def describe_policy(
    name: str,
    scenario: Scenario,
    network: NetworkSettings,
    *,
    command: str,
    seed: int,
    steps: int,
    repeat: int = 1,
    stochastic: bool = True,
    needs: TeamNeeds | None = None,
) -> PolicyDescription:
    """The description of a policy trained in ``scenario`` by ``command``, for ``steps`` robot-steps.

    Without ``needs`` it asks for one of each that the training team has: cameras, hats, lasers, pickets.

    Raises:
        ConfigError: for a value out of range.
    """
    return PolicyDescription(
        format=FORMAT,
        package_version=version("coop_envs"),
        name=name,
        inputs=observed_inputs(),
        actions=ACTION_NAMES,
        decision_s=scenario.rates.decision_s,
        repeat=repeat,
        cell_m=scenario.map.cell_m * scenario.map.ego_stride,
        stochastic=stochastic,
        needs=needs or _one_of_each(scenario),
        scenario=scenario.name,
        command=command,
        seed=seed,
        steps=steps,
        network=network,
    )


def read_description(text: str, source: str) -> PolicyDescription:
    """The description in a file's metadata; ``source`` names the file in errors.

    Raises:
        ConfigError: it is no description, or of a policy that this version cannot run.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(source, str(error), "a description in JSON") from None
    if not isinstance(data, dict):
        raise ConfigError(source, data, "a description: names and values in JSON")
    found = data.get("format")
    known = type(found) is int and found == FORMAT
    require(known, f"{source}: format", found, f"{FORMAT}, the one that this version reads")
    try:
        return validated(PolicyDescription, data)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error.field}", error.value, error.expected) from None


def _one_of_each(scenario: Scenario) -> TeamNeeds:
    members = scenario.team.members
    return TeamNeeds(
        cameras=int(any(m.camera is not None for m in members)),
        hats=int(any(m.hat is not None for m in members)),
        lasers=int(any(m.laser is not None for m in members)),
        pickets=int(any(m.role == "picket" for m in members)),
    )


def _check_inputs(inputs: tuple[Input, ...]) -> None:
    expected = observed_inputs()
    names = [part.name for part in expected]
    require([part.name for part in inputs] == names, "inputs", [part.name for part in inputs], f"{', '.join(names)}")
    for got, wanted in zip(inputs, expected, strict=True):
        field, number = f"inputs.{wanted.name}", len(wanted.entries)
        require(len(got.entries) == number, field, f"{len(got.entries)} entries", f"the {number} that are observed")
        for k, (entry, seen) in enumerate(zip(got.entries, wanted.entries, strict=True)):
            require(entry == seen, f"{field}[{k}]", _told(entry), f"{_told(seen)}, which is observed")


def _told(entry: Entry) -> str:
    return f"{entry.name} in {entry.scale:g} {entry.unit}"


def metadata_of(description: PolicyDescription) -> dict[str, str]:
    """The entry that goes into the file's metadata."""
    return {METADATA_KEY: description.to_json()}


def description_in(metadata: dict[str, Any], source: str) -> PolicyDescription:
    """The description in a file's metadata.

    Raises:
        ConfigError: there is none, or `read_description` refuses it.
    """
    text = metadata.get(METADATA_KEY)
    if text is None:
        raise ConfigError(f"{source}: metadata", sorted(metadata), f"an entry {METADATA_KEY}")
    return read_description(text, source)
