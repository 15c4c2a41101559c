"""`TrainingError`: what stops a training that was set up well."""

from __future__ import annotations

from coop_envs.errors import CoopError


class TrainingError(CoopError):
    """Training cannot go on: something is not finite, or cannot be written."""
