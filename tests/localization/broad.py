"""Recordings of the BROAD data set (Laidig, Caruso, Cereatti, Seel 2021), where they lie beside the repository."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

SHARED = Path(__file__).parents[3] / "shared" / "data"
TRIALS = ("broad_05_undisturbed_slow_rotation_with_breaks_B", "broad_14_undisturbed_slow_translation_with_breaks_B")
NEEDED = pytest.mark.skipif(
    not all((SHARED / f"{trial}.hdf5").is_file() for trial in TRIALS), reason="needs ../shared/data/broad_*.hdf5"
)


@dataclass(frozen=True, eq=False)
class Recording:
    """Gyro and force (T, 3), whether the IMU moves (T,), reference attitude (T, 3, 3) and where there is none (T,)."""

    rate_hz: float
    gyro: np.ndarray
    accel: np.ndarray
    moves: np.ndarray
    reference: np.ndarray
    known: np.ndarray


def recording(trial: str) -> Recording:
    import h5py

    with h5py.File(SHARED / f"{trial}.hdf5") as file:
        read: dict[str, Any] = {name: file[name] for name in ("imu_gyr", "imu_acc", "movement", "opt_quat")}
        gyro, accel, moves, wxyz = (np.array(part) for part in read.values())
        rate_hz = float(np.asarray(file.attrs["sampling_rate"]))
    known = np.asarray(np.isfinite(wxyz).all(axis=1))
    wxyz[~known] = (1.0, 0.0, 0.0, 0.0)
    return Recording(rate_hz, gyro, accel, moves, Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).as_matrix(), known)
