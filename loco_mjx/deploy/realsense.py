"""A RealSense depth camera: its newest image, as the policy was trained to see.

A thread takes every frame as it comes: crop to the field of view of training, median filter, holes to the far clip,
resize. Which pixel a ray of training falls on is told by the stream's intrinsics, not by the data sheet.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loco_mjx.deploy.folder import Camera
from loco_mjx.deploy.robot import Frame, RobotError
from loco_mjx.errors import UserError

SIZE, RATES = (424, 240), (60, 30)  # pixels; frames per second, the first that the camera has
FIRST_FRAME = 3.0  # s until the first frame has to be there
WAIT = 0.1  # s that the thread waits before it looks whether it is to end
MEASURED = 0.05  # of an image's pixels that have to be measured: of the ground alone there are more
OUTSIDE = 0.05  # of the image's width and height by which rays may miss it; they read its border


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera, pixels."""

    width: int
    height: int
    fx: float
    fy: float
    ppx: float
    ppy: float


class Sampler:
    """From a camera's raw image to the policy's."""

    def __init__(self, camera: Camera, intrinsics: Intrinsics) -> None:
        """Finds the pixel of every ray.

        Raises:
            UserError: if the camera sees less than the policy was trained to see.
        """
        self.camera = camera
        half_width = math.tan(math.radians(camera.horizontal_fov) / 2)
        half_height = math.tan(math.radians(camera.vertical_fov) / 2)
        right = half_width * ((2 * np.arange(camera.width) + 1) / camera.width - 1)
        down = half_height * ((2 * np.arange(camera.height) + 1) / camera.height - 1)
        columns = intrinsics.ppx + intrinsics.fx * right
        rows = intrinsics.ppy + intrinsics.fy * down
        for rays, size, name in ((columns, intrinsics.width, "wide"), (rows, intrinsics.height, "high")):
            if max(-rays.min(), rays.max() - (size - 1)) > OUTSIDE * size:
                raise UserError(
                    f"the depth camera does not see as {name} as the policy, which was trained with "
                    f"{camera.horizontal_fov}° × {camera.vertical_fov}°; train one with what it sees"
                )
        self._columns = np.clip(np.rint(columns).astype(int), 0, intrinsics.width - 1)
        self._rows = np.clip(np.rint(rows).astype(int), 0, intrinsics.height - 1)

    def __call__(self, raw: np.ndarray, unit: float) -> np.ndarray:
        """(height, width) planar depth, m, within [near, far].

        Args:
            raw: (rows, columns) uint16, 0 where nothing was measured.
            unit: metres per count.
        """
        top, left = self._rows.min(), self._columns.min()
        crop = np.pad(raw[top : self._rows.max() + 1, left : self._columns.max() + 1], 1, mode="edge")
        # The 3 × 3 median, of the pixels that the resized image takes and of no others.
        near = [crop[np.ix_(self._rows - top + i, self._columns - left + j)] for i in range(3) for j in range(3)]
        median = np.partition(np.stack(near), 4, axis=0)[4]
        metres = np.where(median == 0, self.camera.far, median * unit)
        return np.clip(metres, self.camera.near, self.camera.far)


class RealSense:
    """The first camera found; it delivers from the start until :meth:`close`.

    Attributes:
        newest: the last image that came; None before the first.
    """

    def __init__(self, camera: Camera, now: Callable[[], float], sensors: Sequence[Any] | None = None) -> None:
        """Starts the stream and waits for a frame.

        Args:
            camera: of the policy.
            now: the robot's clock, s.
            sensors: of pyrealsense2, to look for the stream in; None: all that the computer has.

        Raises:
            UserError: without pyrealsense2 or its libusb, or if the camera does not see what the policy needs.
            RobotError: if there is no camera, or no frame comes.
        """
        rs = _library()
        self._rs, self._now = rs, now
        self.newest: Frame | None = None
        self._error: str | None = None
        self._blank = False
        self._ended = threading.Event()
        try:
            self._sensor, profile = self._find(rs.context().query_all_sensors() if sensors is None else sensors)
        except RuntimeError as error:
            raise RobotError(f"the depth camera cannot be found: {error}") from error
        found = profile.as_video_stream_profile().get_intrinsics()
        size = (found.width, found.height)
        self._sampler = Sampler(camera, Intrinsics(*size, found.fx, found.fy, found.ppx, found.ppy))
        self._queue = rs.frame_queue(1)
        try:
            self._sensor.open(profile)
            self._sensor.start(self._queue)
        except RuntimeError as error:  # another program has it
            with contextlib.suppress(RuntimeError):
                self._sensor.close()
            raise RobotError(f"the depth camera cannot be started: {error}") from error
        self._thread = threading.Thread(target=self._take, daemon=True, name="depth camera")
        self._thread.start()

    def depth(self) -> Frame:
        """The newest image.

        Raises:
            RobotError: if none has come, or the camera has failed.
        """
        if self._error is not None:
            raise RobotError(f"the depth camera has failed: {self._error}")
        if self.newest is None:
            measured = "measures nothing; is it covered, or too near?" if self._blank else "has sent no frame"
            raise RobotError(f"the depth camera {measured}")
        return self.newest

    def wait(self, seconds: float = FIRST_FRAME) -> None:
        """Waits for the first frame.

        Raises:
            RobotError: if it does not come.
        """
        end = time.monotonic() + seconds
        while self.newest is None and self._error is None and time.monotonic() < end:
            time.sleep(0.01)
        self.depth()

    def close(self) -> None:
        """Stops the stream."""
        self._ended.set()
        self._thread.join(10 * WAIT)
        try:
            self._sensor.stop()
            self._sensor.close()
        except RuntimeError:
            pass  # it has gone

    def _find(self, sensors: Sequence[Any]) -> tuple[Any, Any]:
        """The first sensor that has the stream, and the stream."""
        wanted = [(self._rs.stream.depth, self._rs.format.z16, *SIZE, rate) for rate in RATES]
        for sensor in sensors:
            videos = (p for p in sensor.get_stream_profiles() if p.is_video_stream_profile())
            profiles = [p.as_video_stream_profile() for p in videos]
            has = {(p.stream_type(), p.format(), p.width(), p.height(), p.fps()): p for p in profiles}
            for key in wanted:
                if key in has:
                    return sensor, has[key]
        raise RobotError(f"there is no depth camera with {SIZE[0]} × {SIZE[1]} images at {RATES} frames per second")

    def _take(self) -> None:
        try:
            while not self._ended.is_set():
                there, frame = self._queue.try_wait_for_frame(int(1000 * WAIT))
                if there:
                    exposed = self._now() - self._age(frame)
                    raw = np.asanyarray(frame.get_data())
                    self._blank = np.count_nonzero(raw) < MEASURED * raw.size
                    if self._blank:  # no image: the last one grows old
                        continue
                    self.newest = Frame(exposed, self._sampler(raw, frame.as_depth_frame().get_units()))
        except Exception as error:  # whatever it is, the robot must hear of it
            self._error = str(error)

    def _age(self, frame: Any) -> float:
        """Seconds since a frame's exposure; 0 where its clock is the camera's own."""
        domain = self._rs.timestamp_domain
        if frame.get_frame_timestamp_domain() not in (domain.system_time, domain.global_time):
            return 0.0
        return max(0.0, time.time() - 0.001 * frame.get_timestamp())


def _library() -> Any:
    """The module pyrealsense2.

    Raises:
        UserError: if it is not installed, or cannot be loaded.
    """
    try:
        import pyrealsense2
    except ModuleNotFoundError:
        raise UserError("the depth camera needs pyrealsense2: pip install 'loco-mjx[a1]'") from None
    except ImportError as error:  # the wheel does not bring the system's libraries that it loads
        if "libusb" in str(error):
            raise UserError("the depth camera needs libusb: apt-get install libusb-1.0-0") from None
        raise UserError(f"the depth camera needs pyrealsense2, which cannot be loaded: {error}") from None
    return pyrealsense2
