"""Frames from real files, folders and a real stream: in time, in order, of the right size, or refused."""

from __future__ import annotations

import http.server
import threading
import time

import cv2
import numpy as np
import pytest

from coop_envs.errors import ConfigError
from coop_envs.validation import validated
from hardware_bridge.cameras.opencv_camera import OpencvCamera, OpencvCameraSettings
from hardware_bridge.emulators.frame_drawing import FrameDrawer
from hardware_bridge.link import LinkError
from tests.hardware_bridge.ros import until
from tests.sensing.scenes import CAMERA


class Clock:
    def __init__(self) -> None:
        self.time_s = 100.0

    def __call__(self) -> float:
        return self.time_s


def image(k):
    """A light that wanders to the right, ten pixels a frame."""
    return FrameDrawer(640, 480).draw([(100.0 + 10 * k, 200.0, 120.0, 1.0)])


@pytest.fixture
def folder(tmp_path):
    for k in range(5):
        cv2.imwrite(str(tmp_path / f"{k:03}.png"), image(k))
    (tmp_path / "notes.txt").write_text("no image")
    (tmp_path / "002b.png").write_bytes(b"no image either")
    return tmp_path


@pytest.fixture
def video(tmp_path):
    path = tmp_path / "run.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    for k in range(5):
        writer.write(image(k))
    writer.release()
    return path


def camera(source, now=None, **settings):
    return OpencvCamera("scout", CAMERA, OpencvCameraSettings("opencv", source, **settings), now or Clock())


@pytest.mark.parametrize("kind", ["folder", "video"])
def test_files_and_folders_play_by_the_clock_and_end(kind, request):
    clock, source = Clock(), str(request.getfixturevalue(kind))
    recorded = camera(source, clock, fps=10.0)
    assert recorded.connect() == f"{source}, 640 x 480" and recorded.name == "scout"
    assert [frame.host_s for frame in recorded.read()] == [100.0]
    assert recorded.read() == []
    clock.time_s = 100.25
    frames = recorded.read()
    assert [frame.host_s for frame in frames] == pytest.approx([100.1, 100.2])
    assert [frame.blobs[0][0] for frame in frames] == pytest.approx([110.0, 120.0], abs=0.5)
    clock.time_s = 109.0
    assert [frame.blobs[0][0] for frame in recorded.read()] == pytest.approx([130.0, 140.0], abs=0.5)
    with pytest.raises(LinkError, match=r"scout: camera .*: got the end of its images, expected more of them"):
        recorded.read()
    recorded.close()


class Stream(http.server.BaseHTTPRequestHandler):
    """A camera as many are: JPEGs in a multipart answer, 30 a second, ``frames`` of them."""

    frames = 1000

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        jpeg = cv2.imencode(".jpg", image(0))[1].tobytes()
        try:
            for _ in range(self.frames):
                self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg))
                self.wfile.write(jpeg + b"\r\n")
                time.sleep(1 / 30)
        except OSError:
            pass

    def log_message(self, *_):
        pass


@pytest.fixture
def stream():
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Stream) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/camera.mjpg"
        server.shutdown()
        thread.join()


def test_a_stream_gives_its_newest_frames_and_is_gone_when_it_ends(stream, monkeypatch):
    monkeypatch.setattr(Stream, "frames", 40)
    live = camera(stream, time.monotonic)
    before = time.monotonic()
    live.connect()
    frames = until(live.read)
    assert before <= frames[0].host_s <= time.monotonic()
    assert frames[0].blobs[0][:2] == pytest.approx((100.0, 200.0), abs=0.5)

    def ended():
        try:
            assert len(live.read()) <= 8
        except LinkError as error:
            return "the end of its images" in str(error)
        return False

    until(ended)
    live.close()


def test_a_live_camera_closes_while_frames_come(stream):
    live = camera(stream, time.monotonic)
    live.connect()
    live.close()
    assert not any(thread.name == "camera scout" for thread in threading.enumerate())


def test_absent_empty_and_broken_sources_are_refused_in_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.avi").write_text("no video")
    for source, text in [
        (str(tmp_path / "nowhere"), "got no .*nowhere, expected a camera, file or folder that exists"),
        (77, "got no /dev/video77, expected a camera"),
        (str(tmp_path / "empty"), "got no image, expected one at least"),
        (
            str(tmp_path / "text.avi"),
            "got no images from .*text.avi, expected a camera or a video that OpenCV can open",
        ),
    ]:
        with pytest.raises(LinkError, match=text) as error:
            camera(source).connect()
        assert "\n" not in str(error.value)


def test_images_of_another_size_than_calibrated_are_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((240, 320, 3), dtype=np.uint8))
    with pytest.raises(LinkError, match="got images of 320 x 240, expected 640 x 480, as calibrated"):
        camera(str(tmp_path)).connect()


def test_settings_are_checked():
    settings = validated(OpencvCameraSettings, {"kind": "opencv", "source": 2, "detection": {"threshold": 200}})
    assert settings.live and settings.detection.threshold == 200
    assert not OpencvCameraSettings("opencv", "recorded.avi").live
    for wrong in ({"source": -1}, {"source": ""}, {"source": 0, "fps": 0.0}, {"source": 0, "lens": 1}):
        with pytest.raises(ConfigError):
            validated(OpencvCameraSettings, {"kind": "opencv", **wrong})
