"""Videos from pictures: mp4 (H.264, plays in every browser) or gif."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from coop_envs.errors import ConfigError
from coop_envs.recording.whole_file import written_whole
from coop_envs.viewer.canvas import Picture

SUFFIXES = (".mp4", ".gif")


def write_video(pictures: Iterable[Picture], path: str | Path, fps: float) -> Path:
    """Write pictures (height, width, 3), uint8 RGB and all of one shape, as a video that exists whole or not at all.

    Pictures are taken one by one, so a generator need not hold them all. Mp4 wants even sides: an odd one is continued
    by a copy of its last row or column.

    Raises:
        ConfigError: another suffix, a frame rate of zero or less, or no picture.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise ConfigError("video", str(path), f"a path that ends in {' or '.join(SUFFIXES)}")
    if not fps > 0:
        raise ConfigError("fps", fps, "more than 0 pictures a second")
    with written_whole(path) as part:
        write = _write_mp4 if path.suffix == ".mp4" else _write_gif
        if not write(pictures, part, fps):
            raise ConfigError("video", str(path), "at least one picture to show")
    return path


def _write_mp4(pictures: Iterable[Picture], path: Path, fps: float) -> bool:
    import imageio.v2 as imageio

    empty = True
    options: dict[str, Any] = {"codec": "libx264", "pixelformat": "yuv420p", "macro_block_size": 2}
    video: Any = imageio.get_writer(path, fps=fps, **options)
    with video:
        for picture in _even(pictures):
            video.append_data(picture)
            empty = False
    return not empty


def _write_gif(pictures: Iterable[Picture], path: Path, fps: float) -> bool:
    """Write a gif in its first picture's colours; a gif's clock ticks at 0.01 s and viewers want 0.02 s or more."""
    from PIL import Image

    remaining = iter(pictures)
    first = next(remaining, None)
    if first is None:
        return False
    start = Image.fromarray(first).quantize(256, dither=Image.Dither.NONE)
    rest = (Image.fromarray(p).quantize(palette=start, dither=Image.Dither.NONE) for p in remaining)
    start.save(path, save_all=True, append_images=rest, duration=max(20, round(1000 / fps, -1)), loop=0)
    return True


def _even(pictures: Iterable[Picture]) -> Iterator[Picture]:
    for picture in pictures:
        height, width = picture.shape[:2]
        yield np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
