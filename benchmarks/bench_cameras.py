"""Time and accuracy of finding blobs of light in drawn frames. Prints a table, writes JSON.

    python benchmarks/bench_cameras.py [--out FILE.json] [--quick]

Frames of 640 x 480 with as many lights of signal 0.5 as a row says; medians over repetitions, OpenCV on one thread.
Errors are root mean squares over lights of one signal at random places and hues.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from hardware_bridge.cameras.detection import DetectionSettings, find_blobs
from hardware_bridge.emulators.frame_drawing import FrameDrawer

WIDTH, HEIGHT = 640, 480
COUNTS, SIGNALS = (0, 6, 18, 36), (0.1, 0.3, 1.0, 6.0)
SETTINGS = DetectionSettings()
Light = tuple[float, float, float, float]


def scattered(rng: np.random.Generator, count: int, signal: float) -> list[Light]:
    """Lights in cells of their own, so that none touch."""
    cells = rng.permutation(48)[:count]
    return [
        (80 * (k % 8) + rng.uniform(25, 55), 80 * (k // 8) + rng.uniform(25, 55), rng.uniform(0, 360), signal)
        for k in cells
    ]


def time_ms(repetitions: int, count: int) -> dict[str, float]:
    """Milliseconds a frame."""
    frame = FrameDrawer(WIDTH, HEIGHT).draw(scattered(np.random.default_rng(0), count, 0.5))
    find_blobs(frame, SETTINGS)
    spent = []
    for _ in range(repetitions):
        begin = time.perf_counter()
        find_blobs(frame, SETTINGS)
        spent.append((time.perf_counter() - begin) * 1e3)
    return {"median_ms": statistics.median(spent), "p99_ms": float(np.quantile(spent, 0.99))}


def errors(frames: int, signal: float) -> dict[str, float]:
    """Errors of centre (px), hue (degrees) and signal (share), and the share of lights that were found."""
    rng, drawer = np.random.default_rng(1), FrameDrawer(WIDTH, HEIGHT)
    rows, drawn = [], 0
    for _ in range(frames):
        truth = scattered(rng, 6, signal)
        drawn += len(truth)
        for u, v, hue, found in find_blobs(drawer.draw(truth), SETTINGS):
            near = min(truth, key=lambda light, u=u, v=v: np.hypot(light[0] - u, light[1] - v))
            off = np.hypot(near[0] - u, near[1] - v) / np.sqrt(2)
            rows.append((off, (hue - near[2] + 180) % 360 - 180, found / signal - 1))
    centre, hue, share = np.sqrt(np.mean(np.square(rows), axis=0))
    return {"centre_px": centre, "hue_deg": hue, "signal": share, "found": len(rows) / drawn}


def measure(quick: bool) -> dict[str, Any]:
    """All figures."""
    cv2.setNumThreads(1)
    repetitions = 50 if quick else 500
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "detection": {str(count): time_ms(repetitions, count) for count in COUNTS},
        "errors": {str(signal): errors(10 if quick else 50, signal) for signal in SIGNALS},
    }


def show(figures: dict[str, Any]) -> None:
    """Print the figures beside their targets."""
    table = Table("figure", "measured", "target", title=f"blobs in frames ({figures['machine']})")
    for count, row in figures["detection"].items():
        table.add_row(f"{count} lights", f"{row['median_ms']:.2f} ms, p99 {row['p99_ms']:.2f} ms", "3 ms")
    for signal, row in figures["errors"].items():
        text = f"{row['centre_px']:.3f} px, {row['hue_deg']:.1f} deg, signal {100 * row['signal']:.0f} %"
        target = "0.1 px, 5 deg" if signal == "1.0" else ""
        table.add_row(f"errors at signal {signal}", f"{text}, {100 * row['found']:.1f} % found", target)
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions")
    options = parser.parse_args()
    figures = measure(options.quick)
    show(figures)
    if options.out:
        options.out.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
