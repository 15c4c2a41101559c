"""A quadratic power matrix regressed back from a log of power states and measured power.

Power is linear in the distinct products of the state's entries: the rows of least squares are the upper triangle of
x x^T. Standard errors assume independent errors of equal size in the measured power.

Source: thesis section 6.2.2 ("it is straightforward to regress a quadratic power model"), eqs (6.1), (6.7), (6.8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_envs.errors import ConfigError, require

ROBOT_STATE = ("v", "omega", "climb", "1")
MARKER_STATE = ("marker_sum", "1")
SCANNER_STATE = ("galvo", "laser", "1")
SINGULAR = 1e-7  # of the largest singular value, columns scaled to length 1


@dataclass(frozen=True)
class PowerFit:
    """A symmetric ``matrix`` (k, k) in watts per squared unit of the state, and the standard error of each entry.

    ``residual_w`` estimates the standard deviation of a power measurement.
    """

    matrix: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    residual_w: float
    samples: int


def regress_power(states: ArrayLike, power_w: ArrayLike, names: Sequence[str] = ROBOT_STATE) -> PowerFit:
    """The power matrix that fits a log best: ``states`` (n, k), last entry 1, and ``power_w`` (n,).

    Raises:
        ConfigError: the log's shape is wrong, it holds NaN or too few samples, or some products never vary apart; the
            message names them.
    """
    x, p = np.asarray(states, dtype=float), np.asarray(power_w, dtype=float)
    require(x.ndim == 2 and x.shape[1] == len(names), "states", x.shape, f"(samples, {len(names)}): {', '.join(names)}")
    require(p.shape == x.shape[:1], "power_w", p.shape, f"one power for each of {len(x)} states")
    require(bool(np.isfinite(x).all() and np.isfinite(p).all()), "log", "NaN or infinity", "finite numbers")
    i, j = np.triu_indices(len(names))
    products = x[:, i] * x[:, j]
    require(len(p) > len(i), "log", len(p), f"more than {len(i)} samples, one for each product of the state")
    _require_excitation(products, [product_name(names, int(a), int(b)) for a, b in zip(i, j, strict=True)])
    return _fit(products, p, i, j)


def product_name(names: Sequence[str], i: int, j: int) -> str:
    """How a message calls the product of two entries of the state, which may be the constant 1."""
    first, second = names[i], names[j]
    if second == "1":
        return "constant" if first == "1" else first
    return f"{first}^2" if i == j else f"{first}*{second}"


def _require_excitation(products: NDArray[np.float64], names: Sequence[str]) -> None:
    length = np.linalg.norm(products, axis=0)
    still = [name for name, size in zip(names, length, strict=True) if size == 0]
    if still:
        raise ConfigError("log", f"{', '.join(still)} always 0", "states in which each of these differs from 0")
    _, size, right = np.linalg.svd(products / length, full_matrices=False)
    tangled = np.abs(right[size < SINGULAR * size[0]]).max(axis=0, initial=0.0) > 1e-3
    if tangled.any():
        which = ", ".join(name for name, bad in zip(names, tangled, strict=True) if bad)
        raise ConfigError("log", f"{which} linearly dependent", "states in which these vary apart from each other")


def _fit(
    products: NDArray[np.float64], power_w: NDArray[np.float64], i: NDArray[np.intp], j: NDArray[np.intp]
) -> PowerFit:
    length = np.linalg.norm(products, axis=0)
    left, size, right = np.linalg.svd(products / length, full_matrices=False)
    weights = right.T @ ((left.T @ power_w) / size) / length
    residual = power_w - products @ weights
    variance = residual @ residual / (len(power_w) - len(weights))
    error = np.sqrt(variance * np.sum((right.T / size) ** 2, axis=1)) / length
    half = np.where(i == j, 1.0, 0.5)
    order = int(i.max()) + 1
    matrix, standard_error = np.zeros((order, order)), np.zeros((order, order))
    matrix[i, j] = matrix[j, i] = half * weights
    standard_error[i, j] = standard_error[j, i] = half * error
    return PowerFit(matrix, standard_error, float(np.sqrt(variance)), len(power_w))
