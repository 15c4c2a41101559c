"""What would hold a mission up for a moment is done before it begins: late imports, and the collector's long rounds."""

from __future__ import annotations

import gc
import importlib
from collections.abc import Iterator
from contextlib import contextmanager

PLANNING = ("cv2", "scipy.ndimage", "scipy.spatial", "skimage.graph", "skimage.measure")
"""What policies import when they first plan a way: half a second in which nobody would be told anything."""


def preload() -> None:
    """Import what policies will need."""
    for name in PLANNING:
        importlib.import_module(name)


@contextmanager
def frozen_heap() -> Iterator[None]:
    """In the meantime the garbage collector leaves alone what is there now; its full rounds take 0.1 s with it."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
