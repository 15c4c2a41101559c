"""Images over a real roscore: from the emulated Zumy's camera, compressed, of the wrong kind, and none."""

from __future__ import annotations

import re
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from coop_envs.errors import ConfigError
from coop_envs.validation import validated
from hardware_bridge import ros1
from hardware_bridge.cameras.ros1_camera import Ros1Camera, Ros1CameraSettings, compressed_image, raw_image
from hardware_bridge.emulators.frame_drawing import FrameDrawer
from hardware_bridge.link import LinkError
from tests.hardware_bridge.ros import emulated, process_master, until
from tests.sensing.scenes import CAMERA

ros = pytest.mark.ros
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:rospy.*")


def camera_at(topic, **settings):
    return Ros1Camera("scout", CAMERA, Ros1CameraSettings("ros1", topic, process_master(), **settings), time.monotonic)


@ros
def test_lights_of_the_simulator_are_seen_through_images_and_a_dead_node_is_told():
    with emulated(process_master(), "/camera1", "--camera") as (simulator, node):
        simulator.blobs = [[100.25, 50.5, 240.0, 1.0], [300.0, 200.0, 0.0, 2.0]]
        before, camera = time.monotonic(), camera_at("/camera1/image_raw")
        assert camera.connect().startswith("/camera1/image_raw at ")
        frame = until(camera.read)[0]
        assert before < frame.host_s < time.monotonic()
        red, blue = frame.blobs
        assert red[:2] == pytest.approx((300.0, 200.0), abs=0.1) and blue[:2] == pytest.approx((100.25, 50.5), abs=0.1)
        assert abs(blue[2] - 240) < 5 and blue[3] == pytest.approx(1.0, rel=0.15)
        assert frame.spot is not None and frame.spot[:2] == red[:2]
        node.fault("die")

        def told():
            try:
                camera.read()
            except LinkError as error:
                return str(error)
            return None

        assert until(told) == "scout: got nobody at /camera1/image_raw, expected its camera's node"
        camera.close()


@ros
def test_compressed_images_are_read():
    rospy = ros1.start_node("coop_bridge", process_master())
    kind = ros1.message("sensor_msgs/CompressedImage")
    publisher = rospy.Publisher("/squeezed", kind, queue_size=1, latch=True)
    frame = FrameDrawer(640, 480).draw([(100.0, 50.0, 120.0, 1.0)])
    publisher.publish(format="jpeg", data=cv2.imencode(".jpg", frame)[1].tobytes())
    camera = camera_at("/squeezed", compressed=True)
    camera.connect()
    [seen] = camera.read()
    assert seen.blobs[0][:2] == pytest.approx((100.0, 50.0), abs=0.3)
    camera.close()
    publisher.unregister()


@ros
@pytest.mark.parametrize(
    ("encoding", "size", "text"),
    [("bgr8", (320, 240), "an image of 320 x 240"), ("mono8", (640, 480), "the encoding 'mono8'")],
)
def test_images_that_do_not_fit_are_refused(encoding, size, text):
    rospy = ros1.start_node("coop_bridge", process_master())
    topic = f"/misfit_{encoding}"
    publisher = rospy.Publisher(topic, ros1.message("sensor_msgs/Image"), queue_size=1, latch=True)
    width, height = size
    publisher.publish(width=width, height=height, step=3 * width, encoding=encoding, data=bytes(3 * width * height))
    with pytest.raises(LinkError, match=f"scout: got {text}.* at {topic}, expected 640 x 480 images"):
        camera_at(topic).connect()
    publisher.unregister()


@ros
def test_no_images_at_all_are_told():
    with pytest.raises(LinkError, match="scout: got nothing at /dark, expected 640 x 480 images"):
        camera_at("/dark", connect_s=0.3).connect()


def message(**parts):
    whole = {"height": 2, "width": 2, "step": 8, "encoding": "rgb8", "data": bytes(range(16))}
    return SimpleNamespace(**whole | parts)


def test_rows_may_be_padded_and_channels_in_any_order():
    rows = raw_image(message())
    assert rows.tolist() == [[[2, 1, 0], [5, 4, 3]], [[10, 9, 8], [13, 12, 11]]]
    assert raw_image(message(encoding="bgra8")).tolist() == [[[0, 1, 2], [4, 5, 6]], [[8, 9, 10], [12, 13, 14]]]


@pytest.mark.parametrize(
    "wrong", [{"data": b""}, {"step": 5}, {"height": 3}, {"height": 0, "data": b""}, {"encoding": "yuv422"}]
)
def test_messages_that_contradict_themselves_are_refused(wrong):
    with pytest.raises(LinkError):
        raw_image(message(**wrong))


def test_bytes_that_are_no_picture_are_refused():
    for data in (b"", b"\xff\xd8 not a jpeg"):
        with pytest.raises(LinkError, match=re.escape(f"{len(data)} bytes that are no JPEG or PNG")):
            compressed_image(data)
    picture = cv2.imencode(".png", np.full((2, 3, 3), 7, np.uint8))[1].tobytes()
    assert compressed_image(picture).shape == (2, 3, 3)


def test_settings_are_checked():
    for wrong in ({"topic": "image"}, {"topic": "/a", "master": "here"}, {"topic": "/a", "connect_s": 0.0}, {}):
        with pytest.raises(ConfigError):
            validated(Ros1CameraSettings, {"kind": "ros1", **wrong}, "camera")
