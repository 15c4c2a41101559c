"""Recording: what an episode looked like, and what its robots measured, in files that exist whole or not at all."""

from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.recording.log_format import LogMetadata
from coop_envs.recording.log_reader import EpisodeReader
from coop_envs.recording.log_writer import EpisodeWriter
from coop_envs.recording.scan import Scan

__all__ = ["EpisodeReader", "EpisodeWriter", "Frame", "LogMetadata", "Scan", "WorldPicture"]
