"""The records of an MCAP file, whole or cut short."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from coop_envs.errors import ConfigError
from coop_envs.recording.log_format import MAGIC

if TYPE_CHECKING:
    from mcap.records import McapRecord


def ends_well(path: Path) -> bool:
    """Whether an MCAP file ends as a complete one does.

    Raises:
        ConfigError: no MCAP file.
    """
    with path.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise ConfigError("log", str(path), "an MCAP file")
        stream.seek(-len(MAGIC), os.SEEK_END)
        return stream.tell() != 0 and stream.read() == MAGIC


def mcap_records(path: Path, cut: Callable[[], None]) -> Iterator[McapRecord]:
    """All records up to the first that cannot be read; then ``cut`` is called."""
    import zstandard
    from mcap.exceptions import McapError
    from mcap.stream_reader import StreamReader

    # What garbage in place of sizes and of compressed data raises, in lz4 too.
    unreadable = (McapError, struct.error, zstandard.ZstdError, ValueError, OverflowError, MemoryError, RuntimeError)
    with path.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True, record_size_limit=path.stat().st_size).records
        while True:
            try:
                record = next(records)
            except StopIteration:
                return
            except unreadable:
                cut()
                return
            yield record
