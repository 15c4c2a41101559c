"""Reading and writing logs of any format."""

from __future__ import annotations

from pathlib import Path

from coop_envs.errors import ConfigError, require
from coop_envs.localization.logs.csv_folder import read_folder, write_folder
from coop_envs.localization.logs.events import Log
from coop_envs.localization.logs.mcap_file import read_mcap, write_mcap
from coop_envs.localization.logs.team_file import TeamReference
from coop_envs.localization.logs.utias import is_utias, read_utias

FORMATS = "a folder of CSV files, an MCAP file or a ROS 1 bag (version 2.0)"
UTIAS = "None: a folder of Robot1_Odometry.dat and others is of robots without known bodies"


def read_log(path: str | Path, team: TeamReference | None = None) -> Log:
    """The log at ``path``: a folder of CSV files, an MCAP file, a ROS 1 bag, or a folder as `utias` reads it.

    ``team`` (a team's name, a YAML file as a log's ``team.yaml``, its entries, or a `Team`) takes the place of the
    log's own. ``Log.robots[i]`` is then what the log calls member i. What had to be left out stands in ``Log.notes``.

    Raises:
        ConfigError: what cannot be used, with file, line or message, and column.
    """
    path = Path(path)
    try:
        if is_utias(path):
            require(team is None, "team", team, UTIAS)
            return read_utias(path)
        if path.is_dir():
            return read_folder(path, team)
        with path.open("rb") as stream:
            start = stream.read(16)
    except OSError as error:
        raise ConfigError("log", str(path), f"{FORMATS} ({error.strerror})") from None
    if start.startswith(b"\x89MCAP"):
        return read_mcap(path, team)
    if start.startswith(b"#ROSBAG"):
        from coop_envs.localization.logs.rosbag import read_bag

        return read_bag(path, team)
    raise ConfigError("log", str(path), FORMATS)


def write_log(path: str | Path, log: Log) -> None:
    """Write a log, as one MCAP file if ``path`` ends in .mcap, else as a folder of CSV files.

    It appears whole or not at all.

    Raises:
        ConfigError: something else stands there.
    """
    path = Path(path)
    if path.suffix == ".mcap":
        write_mcap(path, log)
    else:
        write_folder(path, log)
