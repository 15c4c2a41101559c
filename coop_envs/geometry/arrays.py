"""Structs of device arrays: allocation by shape, copies to and from NumPy.

Truth, commands, measurements and beliefs are Warp structs whose fields are arrays, so that a kernel takes one argument
for each and the host sees the same names.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray


def field_types(struct: Any) -> dict[str, Any]:
    """Name and Warp type of every field of a Warp struct (the type or an instance)."""
    kind = getattr(struct, "_cls", struct)
    return {name: var.type for name, var in kind.vars.items()}


def allocate(struct: Any, lead: tuple[int, ...], device: str, **shapes: tuple[int, ...]) -> Any:
    """A struct of zeros; a field of k dimensions gets the first k of ``lead`` unless ``shapes`` names its shape."""
    made = struct()
    for name, kind in field_types(struct).items():
        shape = shapes.get(name, lead[: kind.ndim])
        assert len(shape) == kind.ndim, f"{name}: shape {shape} for {kind.ndim} dimensions"
        setattr(made, name, wp.zeros(shape, dtype=kind.dtype, device=device))
    return made


def part_of(struct: Any, rows: slice) -> Any:
    """A struct of the same arrays' ``rows``, sharing their memory."""
    made = getattr(struct, "_cls")()  # noqa: B009  private to Warp
    for name in field_types(struct):
        setattr(made, name, getattr(struct, name)[rows])
    return made


def to_numpy(struct: Any) -> dict[str, NDArray[np.generic]]:
    """A copy of every array by name."""
    return {name: getattr(struct, name).numpy().copy() for name in field_types(struct)}


def assign(struct: Any, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Overwrite every array with the values that `to_numpy` gave.

    Raises:
        ValueError: a name is missing or an array has another shape.
    """
    for name in field_types(struct):
        target = getattr(struct, name)
        source = np.asarray(arrays[name])
        if source.shape != target.numpy().shape:
            raise ValueError(f"{name}: got shape {source.shape}, expected {target.numpy().shape}")
        target.assign(source)
