"""Files that exist whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def unfinished_path(path: Path) -> Path:
    """Where a file is written until it is complete: beside it, ``.part`` before its suffix (writers go by suffixes)."""
    return path.with_name(f"{path.stem}.part{path.suffix}")


@contextmanager
def written_whole(path: str | Path, keep_unfinished: bool = False) -> Iterator[Path]:
    """Yield a path to write to; on success it is renamed to ``path``, on any failure removed (or kept if asked)."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = unfinished_path(path)
    try:
        yield part
        part.replace(path)
    except BaseException:
        if not keep_unfinished:
            part.unlink(missing_ok=True)
        raise
