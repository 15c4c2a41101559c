"""From YAML to frozen dataclasses: strict types, names with suggestions, one-line errors."""

from __future__ import annotations

import difflib
import functools
import re
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import yaml
from pydantic import ConfigDict, TypeAdapter, ValidationError

from coop_envs.errors import ConfigError

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
UNITS = {
    "m": "metres",
    "m_s": "metres per second",
    "s": "seconds",
    "rad": "radians",
    "rad_s": "radians per second",
    "deg": "degrees",
    "px": "pixels",
    "kg": "kilograms",
    "v": "volts",
    "mah": "milliampere-hours",
    "lux": "lux",
}
T = TypeVar("T")


def validated(kind: type[T], data: object, path: str = "") -> T:
    """``data`` as an instance of the dataclass ``kind``; ``path`` prefixes the field in errors.

    Raises: `ConfigError` for the first entry that is missing, unknown, or of the wrong type.
    """
    try:
        return _adapter(kind).validate_python(data)
    except ValidationError as error:
        details = error.errors(include_url=False)[0]
    location = _location(data, details["loc"])
    field = _dotted((path, *location))
    value, expected = _explain(kind, data, location, details)
    raise ConfigError(field, value, expected)


def known(name: object, names: Iterable[str], field: str, what: str) -> str:
    """``name`` if it is one of ``names``; else a `ConfigError` that lists them, nearest first."""
    names = sorted(names)
    if name in names:
        return str(name)
    raise ConfigError(field, name, f"{what}: {', '.join(names)}{suggestion(name, names)}")


def suggestion(name: object, names: Iterable[str]) -> str:
    """A tail for a message: the nearest of ``names``, or nothing."""
    near = difflib.get_close_matches(str(name), list(names), n=1, cutoff=0.5)
    return f"; did you mean {near[0]!r}?" if near else ""


def read_yaml(text: str, source: str) -> dict[str, Any]:
    """The mapping in a YAML text; ``source`` names it in errors."""
    try:
        data = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        problem = " ".join(str(error).split())
        raise ConfigError(source, problem, "valid YAML") from None
    if not isinstance(data, dict):
        raise ConfigError(source, data, "a mapping of names to values")
    return data


class _Loader(yaml.SafeLoader):
    """YAML whose numbers may be written 1e-3, which YAML 1.1 reads as a string."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?\d+(?:\.\d*)?[eE][-+]?\d+$"), list("-+0123456789")
)


@functools.cache
def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _location(data: object, loc: Sequence[str | int]) -> list[str | int]:
    """The path of an error without the union tags that pydantic puts into it."""
    path: list[str | int] = []
    for depth, key in enumerate(loc):
        inside = isinstance(data, Mapping) and key in data
        indexed = isinstance(data, Sequence) and isinstance(key, int) and key < len(data)
        if inside or indexed:
            data = data[key]  # type: ignore[index]
        if inside or indexed or depth == len(loc) - 1:
            path.append(key)
    return path


def _dotted(path: Iterable[str | int]) -> str:
    return ".".join(str(key) for key in path if key != "")


def _explain(kind: type[Any], data: object, location: Sequence[str | int], details: Any) -> tuple[object, str]:
    """What was got and what was expected, for one of pydantic's errors."""
    value, context = details["input"], details.get("ctx", {})
    match details["type"]:
        case "unexpected_keyword_argument" | "extra_forbidden":
            names = _names_at(kind, data, location[:-1])
            expected = f"one of: {', '.join(names)}{suggestion(location[-1], names)}"
            return location[-1], expected
        case "missing" | "missing_argument":
            return None, f"a value{_unit(location)}"
        case "literal_error":
            names = re.findall(r"'([^']+)'", context["expected"])
            return value, f"{context['expected']}{suggestion(value, names)}"
        case "union_tag_invalid":
            names = context["expected_tags"].replace("'", "").split(", ")
            return context["tag"], f"a kind: {', '.join(names)}{suggestion(context['tag'], names)}"
        case "union_tag_not_found":
            return value, "a mapping with an entry 'kind'"
        case "float_parsing" | "float_type":
            return value, f"a number{_unit(location)}"
        case "finite_number":
            return value, f"a finite number{_unit(location)}"
        case "int_parsing" | "int_type" | "int_from_float":
            return value, "a whole number"
        case "tuple_type":
            return value, f"a list{_unit(location)}"
        case "too_long":
            return value, f"at most {context['max_length']} entries"
        case "dataclass_type":
            return value, "a mapping of names to values"
        case _:
            return value, details["msg"].removeprefix("Input should be ").lower()


def _unit(location: Sequence[str | int]) -> str:
    name = next((key for key in reversed(location) if isinstance(key, str)), "")
    units = [unit for suffix, unit in UNITS.items() if name.endswith(f"_{suffix}")]
    return f" in {max(units, key=len)}, without a unit" if units else ""


def _names_at(kind: Any, data: Any, path: Sequence[str | int]) -> list[str]:
    """The field names that are known at a path of nested dataclasses, tuples and unions told apart by ``kind``."""
    for key in path:
        if isinstance(key, int):
            kind = typing.get_args(_chosen(kind, data))[0]
        else:
            kind = typing.get_type_hints(_chosen(kind, data), include_extras=False)[key]
        data = data[key]
    kind = _chosen(kind, data)
    return [f.name for f in fields(kind)] if is_dataclass(kind) else []


def _chosen(kind: Any, data: Any) -> Any:
    """The member of a union that ``data`` stands for."""
    options = [option for option in typing.get_args(kind) if is_dataclass(option)]
    if not options or typing.get_origin(kind) is tuple:
        return kind
    tag = data.get("kind") if isinstance(data, Mapping) else None
    return next((o for o in options if getattr(o, "kind", None) == tag), options[0])
