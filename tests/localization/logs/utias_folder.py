"""Folders in the layout of the UTIAS data sets, written from generated logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from coop_envs.localization.logs.events import Log, Odometry, RangeBearing

BEGIN_S = 1248272272.841


def write_utias(folder: Path, log: Log) -> None:
    """Robots are subjects 1 on, landmarks follow; barcodes are neither."""
    folder.mkdir(parents=True, exist_ok=True)
    number = {name: k + 1 for k, name in enumerate([*log.robots, *log.landmarks])}
    code = {name: 5 + 9 * k for name, k in number.items()}
    lines = [f"{k}\t{code[name]}" for name, k in number.items()]
    put(folder / "Barcodes.dat", "# Subject #    Barcode #", lines)
    places = [f"{number[name]:3d}\t{x:.8f}\t{y:.8f}\t0.00013\t0.00014" for name, (x, y) in log.landmarks.items()]
    put(folder / "Landmark_Groundtruth.dat", "# Subject # x [m] y [m] x std-dev [m] y std-dev [m]", places)
    for name in log.robots:
        path = folder / f"Robot{number[name]}"
        rows = [e for e in log.events if isinstance(e, Odometry) and e.robot == name]
        lines = [f"{BEGIN_S + e.time_s:.3f}\t{e.forward_m_s:.6f}\t{e.yaw_rate_rad_s:.6f}" for e in rows]
        put(Path(f"{path}_Odometry.dat"), "# Time [s]    forward velocity [m/s]    angular velocity[rad/s]", lines)
        seen = [e for e in log.events if isinstance(e, RangeBearing) and e.robot == name]
        lines = [f"{BEGIN_S + e.time_s:.3f}\t{code[e.subject]}\t{e.range_m:.6f}\t{e.bearing_rad:.6f}" for e in seen]
        put(Path(f"{path}_Measurement.dat"), "# Time [s]    Subject #    range [m]    bearing [rad]", lines)
        truth = log.truth[name]
        yaw = np.arctan2(truth.rotation[:, 1, 0], truth.rotation[:, 0, 0])
        rows = zip(truth.time_s + BEGIN_S, truth.position, yaw, strict=True)
        lines = [f"{t:.3f}\t{p[0]:.8f}\t{p[1]:.8f}\t{a:.8f}" for t, p, a in rows]
        put(Path(f"{path}_Groundtruth.dat"), "# Time [s]    x [m]    y [m]    orientation [rad]", lines)


def put(path: Path, title: str, lines: list[str]) -> None:
    path.write_text("\n".join(["# UTIAS layout", title, *lines]) + "\n", encoding="utf-8")
