"""Say what is installed, what is missing, and what each missing piece would enable."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from coop_envs.cli import parse

ENABLES = {
    "bullet": "PyBullet, the contact reference (to come; no wheels above Python 3.11)",
    "dev": "the project's own tests and checks",
    "gtsam": "a factor graph as smoother and oracle (to come)",
    "log": "episode logs: DIR/episodes/*.mcap of `coop evaluate`",
    "mavlink": "robots that speak MAVLink (to come)",
    "policy": "trained policies: policy.onnx run by onnxruntime",
    "rllib": "training on many machines with RLlib",
    "ros1": "robots that speak ROS 1 (Debian: apt install python3-rospy)",
    "ros2": "robots that speak ROS 2 (to come)",
    "serial": "robots on a serial line or an XBee radio",
    "torchrl": "TorchRL through PettingZoo",
    "train": "coop train: PPO by Stable-Baselines3, export to ONNX",
    "viz": "reports, plots and videos",
}


@dataclass(frozen=True)
class Options:
    """Say what is installed, what is missing, and what each missing piece would enable."""

    json: bool = False
    """Print one JSON object instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Print the findings; 1 if a package of the core is missing."""
    options = parse(Options, "doctor", argv)
    findings = examine()
    if options.json:
        sys.stdout.write(json.dumps(findings, indent=2) + "\n")
    else:
        _print_tables(findings)
    return 0 if all(findings["core"].values()) else 1


def examine() -> dict[str, Any]:
    """Versions by package (None if missing), by extra what it enables, and the state of Warp, ffmpeg and the CPU."""
    core, extras = _requirements()
    return {
        "coop_envs": metadata.version("coop_envs"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "core": {name: _version(name) for name in core},
        "extras": {
            extra: {"enables": ENABLES.get(extra, ""), "packages": {name: _version(name) for name in names}}
            for extra, names in sorted(extras.items())
        },
        "warp": _warp(),
        "ffmpeg": _ffmpeg(),
    }


def _requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Packages of the core and of each extra, from the project's own metadata."""
    core: list[str] = []
    extras: dict[str, list[str]] = {}
    for line in metadata.requires("coop_envs") or []:
        found = re.match(r"[\w.-]+", line)
        assert found is not None
        extra = re.search(r"""extra == ['"](\w+)['"]""", line)
        (extras.setdefault(extra[1], []) if extra else core).append(found[0])
    return core, extras


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _warp() -> dict[str, Any] | None:
    if _version("warp-lang") is None:
        return None
    import warp

    from coop_envs.device import prepare

    prepare("cpu")
    cache = Path(warp.config.kernel_cache_dir or "")
    modules = [entry for entry in cache.iterdir() if entry.is_dir()] if cache.is_dir() else []
    return {
        "devices": [f"{device.alias} ({device.name})" for device in warp.get_devices()],
        "kernel_cache": str(cache),
        "compiled_modules": len(modules),
    }


def _ffmpeg() -> str | None:
    if _version("imageio-ffmpeg") is None:
        return shutil.which("ffmpeg")
    import imageio_ffmpeg

    try:
        return imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError:
        return None


def _print_tables(findings: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    warp = findings["warp"] or {"devices": [], "kernel_cache": "none", "compiled_modules": 0}
    console.print(f"coop_envs {findings['coop_envs']}, Python {findings['python']}, {findings['cpus']} CPUs")
    console.print(findings["platform"], highlight=False)
    console.print(f"Warp devices: {', '.join(warp['devices']) or 'none'}")
    console.print(f"Kernel cache: {warp['kernel_cache']}, {warp['compiled_modules']} compiled modules")
    console.print(f"ffmpeg: {findings['ffmpeg'] or 'missing (videos become gif)'}", soft_wrap=True)
    table = Table("extra", "enables", "packages")
    table.add_row("core", "everything", _listed(findings["core"]))
    for extra, entry in findings["extras"].items():
        table.add_row(extra, entry["enables"], _listed(entry["packages"]))
    console.print(table)


def _listed(packages: dict[str, str | None]) -> str:
    return "\n".join(
        f"{name} {version}" if version else f"[red]{name} missing[/]" for name, version in packages.items()
    )
