"""Blobs of a simulator over a real socket."""

from __future__ import annotations

import socket

import pytest

from hardware_bridge.cameras.simulator_camera import SimulatorCamera, frame_of
from hardware_bridge.link import LinkError
from hardware_bridge.reading import CameraFrame
from hardware_bridge.simulator_client import SimulatorClient
from tests.hardware_bridge.ros import SmallSimulator, until


def test_blobs_arrive_stamped_by_the_hosts_clock():
    with SmallSimulator() as simulator:
        camera = SimulatorCamera("scout", SimulatorClient(simulator.address, 0), lambda: 12.5)
        assert camera.connect() == "simulator at {}:{}".format(*simulator.address) and camera.name == "scout"
        simulator.blobs = [[1.0, 2.0, 3.0, 0.5]]
        frames = until(camera.read)
        assert frames[0] == CameraFrame(12.5, ((1.0, 2.0, 3.0, 0.5),), None)
        simulator.blobs = None
        until(lambda: not camera.read())
        simulator.blobs = [[1.0, 2.0, 3.0]]
        until(lambda: camera.read() == [] and camera.garbage)
        camera.close()


def test_no_simulator_is_told():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        camera = SimulatorCamera("scout", SimulatorClient(deaf.getsockname(), 0), lambda: 0.0)
        with pytest.raises(LinkError, match="expected a running simulator"):
            camera.connect()
        camera.close()


def test_nonsense_is_no_frame():
    assert frame_of({"blobs": [], "spot": [1, 2, 0.5]}, 1.0) == CameraFrame(1.0, (), (1.0, 2.0, 0.5))
    for state in (
        {"blobs": "many"},
        {"blobs": [[1, 2, 3, None]]},
        {"blobs": [[1, 2, 3, True]]},
        {"blobs": [1]},
        {"blobs": [], "spot": [1, 2]},
    ):
        assert frame_of(state, 1.0) is None
