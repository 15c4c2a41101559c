"""A camera behind a ROS 1 image topic: ``sensor_msgs/Image``, or ``CompressedImage`` where the radio is slow."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Literal

import cv2
import numpy as np

from coop_envs.agents.specification import Camera
from coop_envs.errors import require
from coop_envs.validation import STRICT
from hardware_bridge import ros1
from hardware_bridge.cameras.detection import DetectionSettings, Image, detect
from hardware_bridge.link import LinkError, Now
from hardware_bridge.reading import CameraFrame

CHANNELS = {"bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4}
NEWEST = 8
"""Frames that wait to be read; older ones go first."""
BUFFER_BYTES = 1 << 24
"""More than an image: with rospy's 64 KiB, images pile up behind the newest."""


@dataclass(frozen=True)
class Ros1CameraSettings:
    """Where the images are, and what counts as a blob in them."""

    __pydantic_config__ = STRICT
    kind: Literal["ros1"]
    topic: str
    master: str = "http://localhost:11311"
    compressed: bool = False
    detection: DetectionSettings = field(default_factory=DetectionSettings)
    connect_s: float = 5.0

    def __post_init__(self) -> None:
        ros1.require_master("camera.master", self.master)
        ros1.require_name("camera.topic", self.topic)
        require(0 < self.connect_s <= 60, "camera.connect_s", self.connect_s, "above 0, at most 60 seconds")


class Ros1Camera:
    """A `FrameSource`; blobs are found in rospy's thread as images come.

    ``garbage`` counts images that could not be used, ``misfit`` says what was wrong with the last of them.
    """

    def __init__(self, name: str, camera: Camera, settings: Ros1CameraSettings, now: Now) -> None:
        self._name, self._camera, self._settings, self._now = name, camera, settings, now
        self._frames: deque[CameraFrame] = deque(maxlen=NEWEST)
        self._lock = threading.Lock()
        self._subscriber: Any = None
        self.garbage = 0
        self.misfit: str | None = None

    @property
    def name(self) -> str:
        """The agent whose camera it is."""
        return self._name

    def connect(self) -> str:
        """Wait for a first image.

        Raises:
            LinkError: no ROS, no master, no image, or images of another size or encoding.
        """
        settings = self._settings
        rospy = ros1.start_node("coop_bridge", settings.master)
        kind = ros1.message("sensor_msgs/CompressedImage" if settings.compressed else "sensor_msgs/Image")
        self._subscriber = rospy.Subscriber(
            settings.topic, kind, self._take, queue_size=1, buff_size=BUFFER_BYTES, tcp_nodelay=True
        )
        end = time.monotonic() + settings.connect_s
        while not self._frames and self.misfit is None and time.monotonic() < end:
            time.sleep(0.01)
        if not self._frames:
            self.close()
            expected = f"{self._camera.width_px} x {self._camera.height_px} images"
            raise LinkError(f"{self._name}: got {self.misfit or 'nothing'} at {settings.topic}, expected {expected}")
        return f"{settings.topic} at {settings.master}, {self._camera.width_px} x {self._camera.height_px}"

    def read(self) -> list[CameraFrame]:
        """Every frame since the last call, the newest 8 at most, oldest first.

        Raises:
            LinkError: nobody sends images any more.
        """
        with self._lock:
            frames = list(self._frames)
            self._frames.clear()
        if not frames and not (self._subscriber and ros1.connected(self._subscriber)):
            raise LinkError(f"{self._name}: got nobody at {self._settings.topic}, expected its camera's node")
        return frames

    def close(self) -> None:
        """Leave the topic."""
        subscriber, self._subscriber = self._subscriber, None
        if subscriber is not None:
            subscriber.unregister()

    def _take(self, message: Any) -> None:
        host_s = self._now()
        try:
            image = compressed_image(message.data) if self._settings.compressed else raw_image(message)
            size = image.shape[1::-1]
            if size != (self._camera.width_px, self._camera.height_px):
                raise LinkError(f"an image of {size[0]} x {size[1]}")
        except LinkError as error:
            self.garbage += 1
            self.misfit = str(error)
            return
        frame = detect(host_s, image, self._settings.detection)
        with self._lock:
            self._frames.append(frame)


def raw_image(message: Any) -> Image:
    """The BGR image of a ``sensor_msgs/Image``.

    Raises:
        LinkError: an encoding that is not 8 bits of colour, or data that do not fill the image.
    """
    channels = CHANNELS.get(message.encoding)
    if channels is None:
        raise LinkError(f"the encoding {message.encoding!r} (not one of {', '.join(CHANNELS)})")
    height, width, step = message.height, message.width, message.step
    if step < width * channels or len(message.data) != height * step or height * width == 0:
        raise LinkError(f"{len(message.data)} bytes for {height} rows of {step} bytes, {width} pixels each")
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(height, step)
    pixels = rows[:, : width * channels].reshape(height, width, channels)[..., :3]
    return np.ascontiguousarray(pixels[..., ::-1] if message.encoding.startswith("rgb") else pixels)


def compressed_image(data: bytes) -> Image:
    """The BGR image in a JPEG or PNG.

    Raises:
        LinkError: it is none.
    """
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR) if data else None
    if image is None:
        raise LinkError(f"{len(data)} bytes that are no JPEG or PNG")
    return np.asarray(image, dtype=np.uint8)
