"""The devices that kernels run on."""

from __future__ import annotations

import warp as wp

from coop_envs.errors import ConfigError


def prepare(device: str) -> str:
    """Silence Warp's start-up messages and check that the device is here.

    Raises:
        ConfigError: there is no such device on this machine.
    """
    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    wp.init()
    known = [str(found) for found in wp.get_devices()]
    if device not in known and not (device == "cuda" and wp.is_cuda_available()):
        raise ConfigError("device", device, f"one of {', '.join(known)}")
    return device
