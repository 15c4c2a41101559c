"""A camera that OpenCV opens: a device by its number or path, a stream's URL, a video file, a folder of images.

Devices and streams are read by a thread of their own, so that their buffers stay empty; files and folders play at
``fps`` by the mission's clock, and then end.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from coop_envs.agents.specification import Camera
from coop_envs.errors import require
from coop_envs.validation import STRICT
from hardware_bridge.cameras.detection import DetectionSettings, Image, detect
from hardware_bridge.link import LinkError, Now
from hardware_bridge.reading import CameraFrame

IMAGES = (".bmp", ".jpeg", ".jpg", ".png")
NEWEST = 8
"""Frames of a device that wait to be read; older ones go first."""
PATIENCE_MS = 3000


@dataclass(frozen=True)
class OpencvCameraSettings:
    """Where images come from, how fast, and what counts as a blob in them."""

    __pydantic_config__ = STRICT
    kind: Literal["opencv"]
    source: int | str
    fps: float = 30.0
    detection: DetectionSettings = field(default_factory=DetectionSettings)
    connect_s: float = 5.0

    def __post_init__(self) -> None:
        named = self.source >= 0 if isinstance(self.source, int) else bool(self.source)
        require(named, "camera.source", self.source, "a device's number, or a device, file, folder or URL")
        require(0 < self.fps <= 1000, "camera.fps", self.fps, "above 0, at most 1000 frames/s")
        require(0 < self.connect_s <= 60, "camera.connect_s", self.connect_s, "above 0, at most 60 seconds")

    @property
    def live(self) -> bool:
        """Whether frames come by themselves."""
        source = self.source
        return isinstance(source, int) or "://" in source or source.startswith("/dev/")


class OpencvCamera:
    """A `FrameSource`."""

    def __init__(self, name: str, camera: Camera, settings: OpencvCameraSettings, now: Now) -> None:
        self._name, self._camera, self._settings, self._now = name, camera, settings, now
        self._frames: deque[CameraFrame] = deque(maxlen=NEWEST if settings.live else None)
        self._lock = threading.Lock()
        self._images: Iterator[Image] = iter(())
        self._release: Callable[[], None] = lambda: None
        self._thread: threading.Thread | None = None
        self._closing = self._ended = False
        self._start_s, self._played = 0.0, 0

    @property
    def name(self) -> str:
        """The agent whose camera it is."""
        return self._name

    def connect(self) -> str:
        """Open the source and see its first image, which is the first frame of files and folders.

        Raises:
            LinkError: no such source, no image in it, or images of another size than the calibration's.
        """
        self._images, self._release = self._opened()
        image = self._first()
        size, wanted = image.shape[1::-1], (self._camera.width_px, self._camera.height_px)
        if size != wanted:
            self.close()
            raise self._error(f"images of {size[0]} x {size[1]}", f"{wanted[0]} x {wanted[1]}, as calibrated")
        self._start_s, self._played = self._now(), 1
        self._add(image, self._start_s)
        if self._settings.live:
            self._thread = threading.Thread(target=self._grab, name=f"camera {self._name}", daemon=True)
            self._thread.start()
        return f"{self._settings.source}, {size[0]} x {size[1]}"

    def read(self) -> list[CameraFrame]:
        """Every frame since the last call, oldest first; of a device the newest 8 at most.

        Raises:
            LinkError: the device is gone; the file or folder has ended.
        """
        if not self._settings.live:
            self._play()
        with self._lock:
            frames = list(self._frames)
            self._frames.clear()
        if self._ended and not frames:
            raise self._error("the end of its images", "more of them")
        return frames

    def close(self) -> None:
        """Let go of the source, once an image that is being waited for has come."""
        self._closing = True
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(PATIENCE_MS / 1000)
        if thread is None or not thread.is_alive():
            self._release()  # while another thread reads, OpenCV would crash
        self._ended = True

    def _opened(self) -> tuple[Iterator[Image], Callable[[], None]]:
        source = self._settings.source
        path = f"/dev/video{source}" if isinstance(source, int) else source
        if not self._settings.live and Path(path).is_dir():
            files = sorted(file for file in Path(path).iterdir() if file.suffix.lower() in IMAGES)
            return (image for file in files if (image := _loaded(file)) is not None), lambda: None
        if "://" not in path and not Path(path).exists():
            raise self._error(f"no {path}", "a camera, file or folder that exists")
        capture = self._capture(source)
        if not capture.isOpened():
            raise self._error(f"no images from {path}", "a camera or a video that OpenCV can open")
        return _images(capture), capture.release

    def _capture(self, source: int | str) -> Any:
        if isinstance(source, str) and "://" in source:
            patience = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, PATIENCE_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, PATIENCE_MS]
            return cv2.VideoCapture(source, cv2.CAP_FFMPEG, patience)
        capture = cv2.VideoCapture(source)
        if self._settings.live:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._camera.width_px)
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._camera.height_px)
            capture.set(cv2.CAP_PROP_FPS, self._settings.fps)
        return capture

    def _first(self) -> Image:
        """The first image; a device may take a while to give one."""
        end = time.monotonic() + self._settings.connect_s
        image = next(self._images, None)
        while image is None and self._settings.live and time.monotonic() < end:
            time.sleep(0.05)
            self._images, self._release = self._opened()
            image = next(self._images, None)
        if image is None:
            self.close()
            raise self._error("no image", "one at least")
        return image

    def _grab(self) -> None:
        """Take a device's images as they come."""
        for image in self._images:
            self._add(image, self._now())
            if self._closing:
                return
        self._ended = True

    def _play(self) -> None:
        """Take the images of a file or folder that are due."""
        due = int((self._now() - self._start_s) * self._settings.fps + 1e-6) + 1
        while self._played < due and not self._ended:
            image = next(self._images, None)
            if image is None:
                self._ended = True
            else:
                self._add(image, self._start_s + self._played / self._settings.fps)
                self._played += 1

    def _add(self, image: Image, host_s: float) -> None:
        frame = detect(host_s, image, self._settings.detection)
        with self._lock:
            self._frames.append(frame)

    def _error(self, got: str, expected: str) -> LinkError:
        return LinkError(f"{self._name}: camera {self._settings.source}: got {got}, expected {expected}")


def _images(capture: Any) -> Iterator[Image]:
    """What a capture gives, until it gives nothing."""
    while True:
        there, image = capture.read()
        if not there:
            return
        yield np.asarray(image, dtype=np.uint8)


def _loaded(file: Path) -> Image | None:
    """An image file; None if it is none, as a download that was cut short."""
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    return None if image is None else np.asarray(image, dtype=np.uint8)
