from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from coop_envs.errors import ConfigError
from coop_envs.viewer.video import write_video

pytestmark = pytest.mark.render
COUNT = 12


def pictures(count: int = COUNT, size: tuple[int, int] = (64, 90)) -> Iterator[np.ndarray]:
    """A red square that walks to the right over grey."""
    for k in range(count):
        picture = np.full((*size, 3), 200, np.uint8)
        picture[20:40, 4 + 5 * k : 24 + 5 * k] = (220, 30, 30)
        yield picture


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_video_shows_its_pictures_in_order(tmp_path: Path, suffix: str) -> None:
    import imageio.v2 as imageio

    path = write_video(pictures(), tmp_path / f"episode{suffix}", fps=5)
    read = [np.asarray(picture)[..., :3].astype(float) for picture in imageio.mimread(path)]
    assert len(read) == COUNT
    for shown, meant in zip(read, pictures(), strict=True):
        assert np.abs(shown - meant).mean() < 6


def test_odd_sides_are_made_even_for_mp4(tmp_path: Path) -> None:
    import imageio.v2 as imageio

    reader = imageio.get_reader(write_video(pictures(size=(63, 91)), tmp_path / "odd.mp4", fps=5))
    assert reader.get_meta_data()["size"] == (92, 64)


@pytest.mark.parametrize("name", ["episode.avi", "episode", "episode.mp4.txt"])
def test_other_formats_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=r"expected a path that ends in \.mp4 or \.gif"):
        write_video(pictures(), tmp_path / name, fps=5)


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_what_fails_midway_leaves_no_file(tmp_path: Path, suffix: str) -> None:
    def broken() -> Iterator[np.ndarray]:
        yield from pictures(3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(broken(), tmp_path / f"episode{suffix}", fps=5)
    with pytest.raises(ConfigError, match="at least one picture"):
        write_video([], tmp_path / f"episode{suffix}", fps=5)
    with pytest.raises(ConfigError, match="fps"):
        write_video(pictures(), tmp_path / f"episode{suffix}", fps=0)
    assert list(tmp_path.iterdir()) == []
