"""The devices that kernels run on."""

from __future__ import annotations

import os
import sys
import tempfile

import warp as wp

from coop_envs.errors import ConfigError

NO_DRIVER = "Could not find or load the NVIDIA CUDA driver"


def prepare(device: str) -> str:
    """Start Warp quietly and check that the device is here.

    Raises:
        ConfigError: there is no such device on this machine.
    """
    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    _start_quietly()
    known = [str(found) for found in wp.get_devices()]
    if device not in known and not (device == "cuda" and wp.is_cuda_available()):
        raise ConfigError("device", device, f"one of {', '.join(known)}")
    return device


def available_cpus() -> int:
    """How many CPUs this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _start_quietly() -> None:
    """Initialise Warp; of what its native part writes to stderr, the line that a machine has no GPU is left out."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as caught:
        stderr = os.dup(2)
        try:
            os.dup2(caught.fileno(), 2)
            wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        caught.seek(0)
        lines = caught.read().splitlines(keepends=True)
    os.write(2, b"".join(line for line in lines if NO_DRIVER.encode() not in line))
