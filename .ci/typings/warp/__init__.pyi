# Kernels are written in Warp's language, not Python's: to the type checker, everything of Warp is Any.
# Arrays are annotated as wp.array2d[float], which both read; wp.array2d(dtype=float) only Warp does.
from typing import Any

def __getattr__(name: str) -> Any: ...
