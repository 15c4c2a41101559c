"""One episode of one policy: run it, sample it once a second, and say how it went."""

from __future__ import annotations

import importlib.util
import itertools
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from coop_envs.policy import Observations, Policy, load_policy
from coop_envs.recording import EpisodeWriter, Frame, LogMetadata, Scan, WorldPicture
from coop_envs.recording.frame import TRAPPED
from coop_envs.viewer.canvas import Picture
from coop_envs.viewer.robots import Trail
from coop_envs.viewer.topview import draw
from coop_envs.viewer.window import episode_window
from train.results import Row, plain

SAMPLE_PERIOD_S = 1.0
VIDEO_SPEED = 5.0
"""Simulated seconds in one second of video."""
SERIES = ("time_s", "coverage", "information_bits", "energy_j", "action_energy_j")
COVERAGE_MARKS = (0.5, 0.9, 0.99)


def make_exploration(**settings: Any) -> Any:
    """`exploration_v0.parallel_env`, imported on the first call."""
    from coop_envs import exploration_v0

    return exploration_v0.parallel_env(**settings)


@dataclass(frozen=True)
class EpisodeJob:
    """What to run: a policy by name or path, in world number ``episode`` of a split, with a seed.

    ``settings`` are the keywords of `exploration_v0.parallel_env`; log and video go to subfolders of ``folder``.
    """

    policy: str
    episode: int
    seed: int
    split: str
    settings: dict[str, Any]
    folder: Path
    log: bool = False
    video: bool = False
    picture: bool = False
    command: str = ""
    make_env: Callable[..., Any] = make_exploration

    @property
    def label(self) -> str:
        return policy_label(self.policy)

    @property
    def name(self) -> str:
        """What the episode's files are called, without suffix."""
        return episode_name(self.label, self.episode)

    @property
    def options(self) -> dict[str, Any]:
        """What `reset` is told besides the seed."""
        return {"world_index": self.episode, "split": self.split}


class Track:
    """The frames of an episode, once a second, with all points measured; maps are kept of the last one alone."""

    def __init__(self) -> None:
        self._frames: list[Frame] = []
        self._last: Frame | None = None

    def add(self, frame: Frame) -> None:
        """Keep a frame."""
        self._frames.append(frame.without_maps())
        self._last = frame

    def series(self) -> Mapping[str, Sequence[float]]:
        """The entries of `SERIES` and the pickets lost over time, to six digits."""
        read = {name: [float(f"{getattr(frame, name):.6g}") for frame in self._frames] for name in SERIES}
        return {**read, "pickets_lost": [_pickets_lost(frame) for frame in self._frames]}

    def scan(self) -> Scan:
        """All points measured."""
        return Scan.joined([frame.scan for frame in self._frames])

    def pictures(self, world: WorldPicture) -> tuple[Picture, Picture]:
        """The top view and the 3-D picture at the end, of the part of the world that the episode reached."""
        from coop_envs.viewer.scene import scene

        assert self._last is not None
        trail, window = Trail.from_frames(self._frames), episode_window(world, self._frames)
        return draw(world, self._last, trail, window=window), scene(world, self._last, trail, window)


def episode_name(label: str, episode: int) -> str:
    """What the files of a policy's episode are called, without suffix."""
    return f"{label}_{episode:04d}"


def policy_label(policy: str) -> str:
    """A policy's name, or that of its file without the suffix; of the folder where the file is called policy.onnx."""
    path = Path(policy)
    if path.suffix not in (".onnx", ".py"):
        return path.name
    return path.absolute().parent.name if path.name == "policy.onnx" else path.stem


def run_episode(job: EpisodeJob) -> Row:
    """Run the episode to its end; one row of the results, plain enough for JSON.

    If the job asks for it, ``pictures`` holds the top view and the 3-D picture at the end, uint8 (height, width, 3).
    """
    started = time.perf_counter()
    policy = load_policy(job.policy)
    track = Track()
    with ExitStack() as stack:
        env = stack.enter_context(closing(job.make_env(**job.settings, render_mode="rgb_array" if job.video else None)))
        observations, _ = env.reset(seed=job.seed, options=job.options)
        policy.reset(env.team_description, job.seed)
        watch = [track.add, stack.enter_context(_log(job, env))] if job.log else [track.add]
        decisions = _play(env, policy, observations, watch)
        if job.video:
            _film(job, env, decisions)
        deque(decisions, maxlen=0)
        scans = any(member.laser is not None for member in env.team_description.members)
        metrics, world = env.metrics(track.scan() if scans else None), env.world_picture()
        limit_s = env.team_description.time_limit_s
    series = track.series()
    row = identity(job) | {"status": "finished", "error": None} | metrics | coverage_times(series, limit_s)
    row = plain(row | {"wall_s": time.perf_counter() - started, "series": series})
    return row | {"pictures": track.pictures(world)} if job.picture else row


def identity(job: EpisodeJob) -> Row:
    """Which episode a row is about."""
    return {
        "policy": job.label,
        "episode": job.episode,
        "seed": job.seed,
        "split": job.split,
        "world_index": job.episode,
    }


def coverage_times(series: Mapping[str, Sequence[float]], limit_s: float) -> dict[str, float | None]:
    """When the shares of `COVERAGE_MARKS` were first covered (simulated s, None if never), and the mean coverage.

    The mean is over the time limit, ``coverage_auc``: an episode that ended early keeps its last coverage.
    """
    times, coverage = np.asarray(series["time_s"]), np.asarray(series["coverage"])
    reached = {mark: times[coverage >= mark] for mark in COVERAGE_MARKS}
    marks = {f"t{100 * mark:.0f}_s": float(when[0]) if when.size else None for mark, when in reached.items()}
    area = np.trapezoid(coverage, times) + coverage[-1] * max(limit_s - times[-1], 0.0)
    return marks | {"coverage_auc": float(area / max(limit_s, times[-1]))}


def _play(
    env: Any, policy: Policy, observations: Observations, watch: Sequence[Callable[[Frame], None]]
) -> Iterator[int]:
    """Yield at the start and after each decision; show a frame to the watchers once a second and at the end.

    Each has the points since the one before, the last one the volume.
    """
    period = max(1, round(SAMPLE_PERIOD_S / env.team_description.decision_s))
    scans: list[Scan] = []
    for decision in itertools.count():
        scans.append(env.scan())
        if decision % period == 0 or not env.agents:
            frame = env.frame(volume=not env.agents).with_scan(Scan.joined(scans))
            scans.clear()
            for show in watch:
                show(frame)
        yield decision
        if not env.agents:
            return
        observations = env.step(policy.act({agent: observations[agent] for agent in env.agents}))[0]


def _pickets_lost(frame: Frame) -> int:
    picket = np.asarray([role == "picket" for role in frame.role])
    return int(np.count_nonzero(picket & (frame.status >= TRAPPED)))


@contextmanager
def _log(job: EpisodeJob, env: Any) -> Iterator[Callable[[Frame], None]]:
    metadata = LogMetadata(env.scenario.name, job.seed, job.label, version("coop_envs"), job.command)
    with EpisodeWriter(job.folder / "episodes" / f"{job.name}.mcap", metadata) as writer:
        writer.write_world(env.world_picture())
        yield writer.write_frame


def _film(job: EpisodeJob, env: Any, decisions: Iterator[int]) -> None:
    from coop_envs.viewer.video import write_video

    suffix = ".mp4" if importlib.util.find_spec("imageio_ffmpeg") else ".gif"
    path = job.folder / "videos" / f"{job.name}{suffix}"
    write_video((env.render() for _ in decisions), path, VIDEO_SPEED / env.team_description.decision_s)
