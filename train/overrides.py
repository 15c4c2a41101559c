"""Option ``--set ENTRY=VALUE``: entries of a scenario replaced from the command line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import tyro

from coop_envs.errors import require
from coop_envs.validation import read_yaml

Overrides = Annotated[tuple[str, ...], tyro.conf.arg(name="set", metavar="ENTRY=VALUE"), tyro.conf.UseAppendAction]


def assignments(entries: Sequence[str]) -> dict[str, Any]:
    """Values by name from texts ENTRY=VALUE, the values as in YAML.

    Raises:
        ConfigError: one is something else.
    """
    values: dict[str, Any] = {}
    for entry in entries:
        name, sign, value = entry.partition("=")
        require(bool(name and sign and value), "set", entry, "ENTRY=VALUE, such as task.time_limit_s=100")
        values[name] = read_yaml(f"value: {value}", f"set {name}")["value"]
    return values
