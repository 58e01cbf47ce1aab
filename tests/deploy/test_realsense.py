"""The depth camera's path, from librealsense's own software device to the image that the policy reads."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from loco_mjx.deploy.mujoco_robot import MujocoRobot
from loco_mjx.deploy.realsense import SIZE, Intrinsics, RealSense, Sampler
from loco_mjx.deploy.robot import RobotError
from loco_mjx.deploy.safety import Cause, Guard, Limits, Stop
from tests import optional
from tests.deploy import flat
from tests.refusals import refusal, says

rs = optional.pyrealsense2()

WIDTH, HEIGHT = SIZE
UNIT = 0.001  # m
CAMERA = replace(flat.manifest().camera, height=64, width=64)
# A D435's at 424 × 240: 87° × 58° about a centre that is a little off.
D435 = Intrinsics(WIDTH, HEIGHT, fx=223.4, fy=216.5, ppx=212.3, ppy=118.6)


def raw_image(intrinsics: Intrinsics) -> np.ndarray:
    """(240, 424) counts: what a camera with these intrinsics would measure in MuJoCo's flat scene with a wall."""
    import mujoco

    columns = (np.arange(WIDTH) - intrinsics.ppx) / intrinsics.fx
    rows = (np.arange(HEIGHT) - intrinsics.ppy) / intrinsics.fy
    down, right = np.meshgrid(rows, columns, indexing="ij")
    rays = np.stack([np.ones(down.size), -right.ravel(), -down.ravel()], axis=-1)
    length = np.linalg.norm(rays, axis=1)
    robot = MujocoRobot(flat.model(), CAMERA, lying=False)
    groups = np.array([0, 0, 1, 0, 0, 0], np.uint8)
    hit, distance = np.full(len(rays), -1, np.int32), np.zeros(len(rays))
    origin = robot.data.qpos[:3] + np.array(CAMERA.offset)
    unit = (rays / length[:, None]).ravel()
    mujoco.mj_multiRay(
        robot.model, robot.data, origin, unit, groups, True, -1, hit, distance, None, len(rays), mujoco.mjMAXVAL
    )
    depth = np.where((hit >= 0) & (distance / length < 20.0), distance / length, 0.0)
    return np.round(depth / UNIT).astype(np.uint16).reshape(HEIGHT, WIDTH)


class Device:
    """A software device that sends what it is given."""

    def __init__(self, intrinsics: Intrinsics = D435) -> None:
        self.device, self.number = rs.software_device(), 0
        self.sensor = self.device.add_sensor("Stereo Module")
        self.sensor.add_read_only_option(rs.option.depth_units, UNIT)
        stream = rs.video_stream()
        stream.type, stream.fmt, stream.bpp, stream.index, stream.uid = rs.stream.depth, rs.format.z16, 2, 0, 1
        stream.width, stream.height, stream.fps = intrinsics.width, intrinsics.height, 30
        inside = rs.intrinsics()
        for name in ("width", "height", "fx", "fy", "ppx", "ppy"):
            setattr(inside, name, getattr(intrinsics, name))
        stream.intrinsics = inside
        self.profile = self.sensor.add_video_stream(stream).as_video_stream_profile()
        self.sensors = self.device.query_sensors()

    def send(self, image: np.ndarray, age: float = 0.0) -> None:
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp, frame.stride = np.ascontiguousarray(image), 2, 2 * image.shape[1]
        frame.timestamp, frame.domain = 1000 * (time.time() - age), rs.timestamp_domain.system_time
        self.number += 1
        frame.frame_number, frame.profile, frame.depth_units = self.number, self.profile, UNIT
        self.sensor.on_video_frame(frame)


@pytest.fixture
def device():
    return Device()


@pytest.fixture
def camera(device):
    made = RealSense(CAMERA, time.monotonic, device.sensors)
    yield made
    made.close()


def newest(camera: RealSense, device: Device, image: np.ndarray, age: float = 0.0):
    """The image that comes of a frame, once it has come."""
    before = camera.newest
    device.send(image, age)
    end = time.monotonic() + 5.0
    while camera.newest is before and time.monotonic() < end:
        time.sleep(0.005)
    return camera.depth()


def test_a_scenes_image_is_the_one_that_rays_compute(camera, device):
    """The policy's own rays, cast by MuJoCo, against a D435's frame of the same scene brought to the same size."""
    direct = MujocoRobot(flat.model(), CAMERA, lying=False).depth().depth
    through = newest(camera, device, raw_image(D435)).depth
    # A ray's pixel is up to half a pixel off: next to nothing on the wall, more on the ground far ahead and at edges.
    off = np.abs(through - direct) / direct
    assert np.median(off) < 0.002 and np.mean(off < 0.04) > 0.97
    ground = direct[40:60]
    np.testing.assert_allclose(through[40:60], ground, rtol=0.04)
    # A crop of the middle, blind to the intrinsics, would be far off: the test can tell.
    other = Sampler(CAMERA, replace(D435, fy=0.9 * D435.fy))(raw_image(D435), UNIT)
    assert np.abs(other[40:60] - ground).max() / ground.min() > 0.1


def test_holes_are_far_and_single_ones_are_filled(camera, device):
    image = np.full((HEIGHT, WIDTH), 2000, np.uint16)
    image[100:140, 200:240] = 0
    image[60, 60:300:10] = 0  # alone among its neighbours: the median's business
    image[10, 100] = 9000
    depth = newest(camera, device, image).depth
    assert set(np.round(depth, 6).ravel()) == {2.0, CAMERA.far}
    far = np.argwhere(depth == CAMERA.far)
    assert 50 < len(far) < 200
    assert far.min() > 25 and far.max() < 40  # in the middle of the image, where the hole is


def test_depth_is_clipped_to_the_policys_range():
    sampler = Sampler(CAMERA, D435)
    assert np.all(sampler(np.full((HEIGHT, WIDTH), 100, np.uint16), UNIT) == CAMERA.near)
    assert np.all(sampler(np.full((HEIGHT, WIDTH), 60000, np.uint16), UNIT) == CAMERA.far)
    np.testing.assert_allclose(sampler(np.full((HEIGHT, WIDTH), 10000, np.uint16), 1e-4), 1.0)


def test_up_left_is_up_left():
    image = np.full((HEIGHT, WIDTH), 1000, np.uint16)
    image[:120, :212] = 3000
    depth = Sampler(CAMERA, D435)(image, UNIT)
    assert depth[5, 5] == 3.0 and depth[5, 60] == depth[60, 5] == depth[60, 60] == 1.0


def test_a_narrow_camera_is_refused():
    with refusal("wide 85.46° 60.0°"):
        Sampler(CAMERA, replace(D435, fx=300.0))
    with refusal("high 85.46° 60.0°"):
        Sampler(CAMERA, replace(D435, fy=260.0))


def test_a_frame_carries_the_time_of_its_exposure(camera, device):
    frame = newest(camera, device, np.full((HEIGHT, WIDTH), 2000, np.uint16), age=0.2)
    assert 0.15 < time.monotonic() - frame.time < 2.0


def test_a_camera_that_stops_is_noticed(camera, device):
    newest(camera, device, np.full((HEIGHT, WIDTH), 2000, np.uint16))
    guard = Guard(replace(flat.manifest(), camera=CAMERA), Limits())
    guard.frame(camera.depth(), time.monotonic())
    time.sleep(Limits().frame_age + 0.05)
    with pytest.raises(Stop) as stop:
        guard.frame(camera.depth(), time.monotonic())
    assert stop.value.cause == Cause.STALE_CAMERA


def test_no_camera_and_no_frame_are_robot_errors(device):
    with refusal("camera 424 240", RobotError):
        RealSense(CAMERA, time.monotonic, Device(replace(D435, width=640)).sensors)
    silent = RealSense(CAMERA, time.monotonic, device.sensors)
    with refusal("camera frame", RobotError):
        silent.wait(0.05)
    silent.close()


def test_an_image_of_nothing_is_none_and_the_last_one_grows_old(camera, device):
    """A covered lens: its image would say that all is free as far as it sees."""
    seen = newest(camera, device, raw_image(D435))
    for _ in range(5):
        device.send(np.zeros((HEIGHT, WIDTH), np.uint16))
        time.sleep(0.02)
    assert camera.depth() is seen
    guard = Guard(replace(flat.manifest(), camera=CAMERA), Limits())
    with pytest.raises(Stop, match=Cause.STALE_CAMERA):
        guard.frame(camera.depth(), time.monotonic() + 1.0)


def test_a_camera_that_another_program_has_is_one_line(device):
    class Busy:
        def __getattr__(self, name):
            return getattr(device.sensors[0], name)

        def open(self, profile):
            raise RuntimeError("Device or resource busy")

    with refusal("camera busy", RobotError):
        RealSense(CAMERA, time.monotonic, [Busy()])


def test_a_camera_that_is_covered_from_the_start_says_so(camera, device):
    said, end = "", time.monotonic() + 5.0
    while "covered" not in said and time.monotonic() < end:  # until its thread has seen one
        device.send(np.zeros((HEIGHT, WIDTH), np.uint16))
        time.sleep(0.02)
        with pytest.raises(RobotError) as caught:
            camera.depth()
        said = str(caught.value)
    assert says(said, "camera measures nothing covered")
