"""From the cells of a log to numbers that can be used; what cannot is refused with its place and column."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.columns import (
    ARRIVAL,
    COVARIANCE,
    POSITION,
    POSITION_COVARIANCE,
    QUATERNION,
    SIGMA_POSITION,
    SIGMA_ROTATION,
    Kind,
    RawRows,
)

Array = NDArray[np.float64]

UNIT_TOLERANCE = 0.01
"""How far a quaternion's norm may be from 1: one rounded to three digits passes."""
LEAST_EIGENVALUE = 1e-12
"""Of a covariance scaled to a unit diagonal: less counts as not positive definite."""


@dataclass(frozen=True, eq=False)
class Table:
    """N rows that passed, by column: texts, and numbers (N,), NaN where an optional cell is empty."""

    kind: Kind
    texts: Mapping[str, Sequence[str]]
    numbers: Mapping[str, Array]
    place: Callable[[int], str]

    def __len__(self) -> int:
        return len(self.texts[self.kind.texts[0]])

    @property
    def time_s(self) -> Array:
        return self.numbers["time_s"]

    @property
    def arrival_s(self) -> Array:
        """(N,), NaN where nobody noted it."""
        return self.numbers.get(ARRIVAL, np.full(len(self), np.nan))

    @property
    def order_s(self) -> Array:
        """(N,) when a row was heard of; where nobody noted that, when it was measured."""
        return np.where(np.isnan(self.arrival_s), self.time_s, self.arrival_s)

    def position(self) -> Array:
        """(N, 3) metres."""
        return self._stacked(POSITION)

    def rotation(self) -> Array:
        """(N, 3, 3) of the quaternions, brought to length 1; NaN where there is none."""
        rotation = np.full((len(self), 3, 3), np.nan)
        given = self.has_rotation()
        if given.any():
            w_last = self._stacked(("qx", "qy", "qz", "qw"))[given]
            rotation[given] = Rotation.from_quat(w_last).as_matrix()
        return rotation

    def has_rotation(self) -> NDArray[np.bool_]:
        """(N,) whether a row has a quaternion."""
        return ~np.isnan(self.numbers.get("qw", np.full(len(self), np.nan)))

    def covariance(self) -> Array:
        """(N, 6, 6) of rotation (rad) and position (m), NaN where a row without rotation says nothing of it."""
        P = np.full((len(self), 6, 6), np.nan)
        if POSITION_COVARIANCE[0] in self.numbers:
            names = COVARIANCE if COVARIANCE[0] in self.numbers else POSITION_COVARIANCE
            i, j = np.triu_indices(6)
            i, j = i[-len(names) :], j[-len(names) :]
            P[:, i, j] = P[:, j, i] = self._stacked(names)
            return P
        rotation = self.numbers.get(SIGMA_ROTATION, np.full(len(self), np.nan))
        sigma = np.repeat(np.column_stack([rotation, self.numbers[SIGMA_POSITION]]), 3, axis=1)
        return np.eye(6) * (sigma * sigma)[:, :, None]

    def _stacked(self, names: Sequence[str]) -> Array:
        return np.column_stack([self.numbers[name] for name in names])

    def refuse(self, row: int, column: str, value: object, expected: str) -> ConfigError:
        """The error that names this row and column."""
        return ConfigError(f"{self.place(row)}, {column}", value, expected)


def checked(raw: RawRows) -> Table:
    """The rows as numbers that can be used.

    Raises:
        ConfigError: a cell that is empty, no number, not finite or out of range, with its place and column.
    """
    kind, cells = raw.kind, raw.columns
    if not len(cells[kind.texts[0]]):
        raise ConfigError(raw.place(-1), "no rows", "at least one")
    texts = {name: _texts(raw, name) for name in kind.texts}
    numbers = {
        name: _numbers(raw, name, name in kind.numbers) for name in kind.columns if name in cells and name not in texts
    }
    table = Table(kind, texts, numbers, raw.place)
    for name in ("range_m", "range_sigma_m", "bearing_sigma_rad"):
        if name in numbers:
            _refuse_first(table, name, numbers[name] <= 0.0, "more than 0")
    if "qw" in numbers:
        _check_quaternions(table)
    if kind.either:
        _check_covariances(table)
    if kind.clock is not None:
        _check_times(table, kind.clock)
    return table


def _texts(raw: RawRows, name: str) -> Sequence[str]:
    cells = raw.columns[name]
    for i, cell in enumerate(cells):
        if not isinstance(cell, str) or not cell or not cell.isprintable():
            raise ConfigError(f"{raw.place(i)}, {name}", cell, "a name")
    return cells  # type: ignore[return-value]


def _numbers(raw: RawRows, name: str, required: bool) -> Array:
    """A column (N,); NaN where an optional cell is empty."""
    cells = raw.columns[name]
    values = _all_numbers(cells)
    if values is None:
        values = np.array([_number(cell) for cell in cells])
        for bad, expected in ((np.isinf(values), "a finite number"), (np.isnan(values) & required, "a number")):
            if bad.any():
                row = int(bad.argmax())
                raise ConfigError(f"{raw.place(row)}, {name}", cells[row], expected)
    return values


def _all_numbers(cells: Sequence[object]) -> Array | None:
    """The cells at once, None unless each is a finite number."""
    kinds = set(map(type, cells))
    if not kinds <= {str, float, int} or (str in kinds and any("_" in str(cell) for cell in cells)):
        return None
    try:
        values = np.fromiter(map(float, cells), dtype=np.float64, count=len(cells))  # type: ignore[arg-type]
    except (ValueError, OverflowError):
        return None
    return values if np.isfinite(values).all() else None


def _number(cell: object) -> float:
    """A cell's finite number, NaN where the cell is empty, infinite where it holds anything else."""
    if cell is None or cell == "":
        return math.nan
    if isinstance(cell, bool) or not isinstance(cell, str | float | int) or "_" in str(cell)[:400]:
        return math.inf
    try:
        value = float(cell)
    except (ValueError, OverflowError):
        return math.inf
    return math.inf if math.isnan(value) else value


def _refuse_first(table: Table, column: str, bad: NDArray[np.bool_], expected: str) -> None:
    if bad.any():
        row = int(bad.argmax())
        raise table.refuse(row, column, float(table.numbers[column][row]), expected)


def _check_quaternions(table: Table) -> None:
    q = np.column_stack([table.numbers[name] for name in QUATERNION])
    given = ~np.isnan(q)
    partly = given.any(axis=1) & ~given.all(axis=1)
    far = np.abs(np.linalg.norm(q, axis=1) - 1.0) > UNIT_TOLERANCE
    for bad, expected in ((partly, "all four or none"), (far, f"a norm within {UNIT_TOLERANCE} of 1")):
        if bad.any():
            row = int(bad.argmax())
            raise table.refuse(row, "qw, qx, qy, qz", q[row].tolist(), expected)


def _check_covariances(table: Table) -> None:
    for name in (SIGMA_ROTATION, SIGMA_POSITION):
        if name in table.numbers:
            _refuse_first(table, name, table.numbers[name] <= 0.0, "more than 0")
    P = table.covariance()
    full, position = table.has_rotation(), P[:, 3:, 3:]
    for rows, part in ((full, P), (~full, position)):
        which = np.flatnonzero(rows)
        empty = np.isnan(part[which]).any(axis=(1, 2))
        if empty.any():
            raise table.refuse(
                int(which[empty.argmax()]), "covariance", "empty cells", "a covariance of all that is measured"
            )
        bad = not_positive(part[which])
        if bad.any():
            row = int(which[bad.argmax()])
            raise table.refuse(
                row, "covariance", np.diag(part[row]).tolist(), "a positive definite matrix (its diagonal is shown)"
            )


def not_positive(P: Array) -> NDArray[np.bool_]:
    """(N,) which of the matrices (N, n, n) are not positive definite."""
    diagonal = np.diagonal(P, axis1=1, axis2=2)
    bad: NDArray[np.bool_] = np.any(~(diagonal > 0.0), axis=1)
    sigma = np.sqrt(np.where(bad[:, None], 1.0, diagonal))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        scaled = P / sigma[:, :, None] / sigma[:, None, :]
    bad |= np.any(~(np.abs(scaled) <= 2.0), axis=(1, 2))
    scaled[bad] = np.eye(P.shape[1])
    try:
        np.linalg.cholesky(scaled - LEAST_EIGENVALUE * np.eye(P.shape[1]))
    except np.linalg.LinAlgError:
        bad |= np.linalg.eigvalsh(scaled)[:, 0] <= LEAST_EIGENVALUE
    return bad


def _check_times(table: Table, clock: str) -> None:
    """That each clock runs forward, or, where arrivals are noted, the host's."""
    owners = np.asarray(counted(table.texts[clock]))
    noted = ~np.isnan(table.arrival_s)
    for owner in range(owners.max() + 1):
        rows = np.flatnonzero(owners == owner)
        if noted[rows].any() and not noted[rows].all():
            row = int(rows[(~noted[rows]).argmax()])
            raise table.refuse(row, ARRIVAL, "", f"a time, as other rows of {table.texts[clock][row]} have")
        column = ARRIVAL if noted[rows[0]] else "time_s"
        values = table.order_s[rows]
        back = np.diff(values) < 0.0
        if back.any():
            k = int(back.argmax())
            late = " or an arrival_s that says it came late" if column == "time_s" and table.kind.optional else ""
            raise table.refuse(
                int(rows[k + 1]), column, float(values[k + 1]), f"time not to go back: {values[k]} s or later{late}"
            )


def counted(names: Sequence[str]) -> list[int]:
    """Each name's number, by the order in which they come first."""
    numbers: dict[str, int] = {}
    return [numbers.setdefault(name, len(numbers)) for name in names]
