"""How far cameras and hats are off, as the filter found out on the way: see `estimation.calibration`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.team import Team
from coop_envs.estimation.belief import ERROR_STATES, calibration_slots
from coop_envs.estimation.calibration import CENTRE, FOCAL, PLACE, TURN
from coop_envs.estimation.settings import Estimation
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.localization.result import CalibrationError

Array = NDArray[np.float64]


def calibrations(
    team: Team, names: tuple[str, ...], settings: Estimation, team_filter: TeamFilter
) -> dict[str, Mapping[str, CalibrationError]]:
    """By the names of robots whose camera or hat the filter calibrates, what it found, by the names in the guide."""
    states = team_filter.belief.calibration.numpy()[0].reshape(-1)
    sigmas = np.sqrt(np.diagonal(team_filter.belief.covariance.numpy()[0])[: len(states)])
    cameras, hats, _ = calibration_slots(team, settings)
    found: dict[str, Mapping[str, CalibrationError]] = {}
    for name, member, camera, hat in zip(names, team.members, cameras, hats, strict=True):
        rows = _camera_rows(camera, settings) if camera >= 0 else {}
        if hat >= 0 and member.hat is not None:
            rows["leds_m"] = _rows(hat, 0, 3 * len(member.hat.leds)).reshape(-1, 3)
        if rows:
            found[name] = {what: CalibrationError(states.take(at), sigmas.take(at)) for what, at in rows.items()}
    return found


def _camera_rows(slot: int, settings: Estimation) -> dict[str, NDArray[np.intp]]:
    """Where a camera's states are, of those that are estimated."""
    parts = {
        "focal": (settings.focal_sigma, FOCAL, 1),
        "centre_px": (settings.centre_sigma_px, CENTRE, 2),
        "place_m": (settings.lever_sigma_m, PLACE, 3),
        "turn_rad": (settings.lever_sigma_rad, TURN, 3),
    }
    found = {what: _rows(slot, int(first), size) for what, (sigma, first, size) in parts.items() if sigma > 0}
    return {what: rows.squeeze() for what, rows in found.items()}


def _rows(slot: int, first: int, size: int) -> NDArray[np.intp]:
    """States of a slot and of those after it; more LEDs than a slot holds go on in the next."""
    return np.arange(ERROR_STATES * slot + first, ERROR_STATES * slot + first + size)
