"""A team of one Zumy that hangs on a simulator small enough to be told what its sensors say."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.hardware_bridge.fake_simulator import FakeSimulator

STEADY_POLICY = """
import numpy as np
from coop_envs.policy import TeamNeeds

class Steady:
    name = "steady"
    needs = TeamNeeds()

    def reset(self, team, seed):
        pass

    def act(self, observations):
        return {name: np.array(ACTION, dtype=np.float32) for name in observations}

def make_policy():
    return Steady()
"""
STANDS, DRIVES = [1, 0, 0, 0, 0, 0, 0, 0], [-1, 0.8, 0, 0, 0, 0, 0, 0]


class RestingRobot(FakeSimulator):
    """On level ground, with a good battery; ``says`` replaces what its sensors say."""

    def __init__(self, **says: Any) -> None:
        super().__init__()
        self.says = {"gyro": [0.0, 0.0, 0.0], "accel": [0.0, 0.0, 9.81], "voltage": 8.0} | says

    def _state(self) -> dict[str, Any]:
        return super()._state() | self.says

    @property
    def stood(self) -> bool:
        """Whether it was never told anything but to stand."""
        return all(told.get("wheels", [0.0, 0.0]) == [0.0, 0.0] for told in list(self.sets))


def steady_policy(folder: Path, action: Sequence[float]) -> str:
    file = folder / "steady.py"
    file.write_text(STEADY_POLICY.replace("ACTION", repr(list(action))))
    return str(file)


def images(folder: Path, width: int = 640, height: int = 480, count: int = 150) -> str:
    """A folder of dark images, for five seconds."""
    place = folder / f"{width}x{height}"
    place.mkdir()
    first = place / "0000.png"
    cv2.imwrite(str(first), np.zeros((height, width, 3), dtype=np.uint8))
    for k in range(1, count):
        (place / f"{k:04}.png").hardlink_to(first)
    return str(place)


def team_file(folder: Path, simulator: FakeSimulator, source: str | int, **entries: Any) -> str:
    host, port = simulator.address.split(":")
    tree = {
        "team": {"name": "lone", "members": [{"role": "observer", "robot": "zumy", "cameras": ["ch6"], "hat": "zumy"}]},
        "robots": {
            "observer_0": {
                "link": {"kind": "simulator", "host": host, "port": int(port), "robot": 0},
                "camera": {"kind": "opencv", "source": source},
            }
        },
        "site": {"start": [[0, 0, 0]]},
        "safety": {"inchworm": False, "max_pose_age_s": None},
        "time_limit_s": 30,
    }
    file = folder / "team.yaml"
    file.write_text(json.dumps(tree | entries))
    return str(file)
