"""The viewer in a real browser; Chromium has to be installed (.ci/run does)."""

from __future__ import annotations

import dataclasses
import socket
import subprocess
import sys
import threading
import time

import imageio.v3 as imageio
import numpy as np
import pytest

from loco_mjx.show.rollout import Agent
from loco_mjx.show.web import Viewer
from tests import optional
from tests.refusals import refusal

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]
VIEWPORT = {"width": 640, "height": 400}  # it is drawn in software, pixel by pixel
PATIENCE = 120.0  # s, beyond which something hangs


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def viewer():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    viewer = Viewer(Agent("zero"), "thin", 3, port=port)
    viewer.port = port
    thread = threading.Thread(target=viewer.run, daemon=True)
    thread.start()
    until(lambda: viewer.rollout is not None)  # compiled, before a browser that renders in software takes the cores
    yield viewer
    viewer.close()
    thread.join(PATIENCE)
    assert not thread.is_alive()


@pytest.fixture
def page(viewer, tmp_path):
    chromium = optional.chromium()
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch_persistent_context(
            tmp_path, executable_path=chromium, headless=True, args=FLAGS, viewport=VIEWPORT
        )
        page = browser.pages[0]
        page.set_default_timeout(1000 * PATIENCE)
        page.goto(f"http://127.0.0.1:{viewer.port}")
        yield page
        browser.close()


def test_the_page_shows_and_steers_the_episode(viewer, page):
    page.get_by_role("button", name="Pause").wait_for()
    assert page.locator("canvas").count() >= 1
    until(lambda: viewer.rollout is not None and viewer.steps > 2)
    page.get_by_text("episode 0,").wait_for()  # what the server says reaches the page

    page.get_by_role("button", name="Pause").click()
    until(lambda: viewer.paused)
    page.get_by_role("button", name="Resume").wait_for()
    stood = viewer.steps
    page.get_by_role("button", name="Step", exact=True).click()
    until(lambda: viewer.steps != stood)
    assert viewer.steps == stood + 1 and viewer.paused

    image = page.locator("img[src^='blob:']").first
    image.wait_for()
    drawn = np.frombuffer(imageio.imread(image.screenshot()).tobytes(), np.uint8)
    assert drawn.std() > 10  # a picture of depth, not a blank

    page.get_by_role("button", name="Reset").click()
    until(lambda: viewer.steps == 0)
    before = np.array(viewer.moment.scene.boxes.center)
    seed = page.get_by_label("Seed")
    seed.fill("8")
    seed.press("Enter")
    until(lambda: viewer.seed == 8 and viewer.steps == 0 and viewer.moment.step == 0)
    until(lambda: not np.array_equal(before, np.array(viewer.moment.scene.boxes.center)))

    viewer.ask(lambda: viewer.choose(task="no such task"))
    page.get_by_text("unknown task").wait_for()
    viewer.ask(lambda: viewer.choose(task="thin"))
    page.get_by_text("episode 0,").wait_for()


def test_depth_stays_depth_and_attention_has_a_panel_of_its_own(viewer):
    """Without a browser: what the server holds for each panel."""
    found = []

    def look():
        for overlay in (False, True):
            viewer.overlay = overlay
            viewer.draw(dataclasses.replace(viewer.moment, attention=np.eye(16)[5]))
            found.append((viewer.scene.eye.visible, np.array(viewer.scene.eye.image), viewer.scene.looked.visible))
        found.append(np.array(viewer.scene.looked.image))
        viewer.overlay = False

    viewer.ask(look)
    until(lambda: len(found) == 3)
    (seen, depth, looked), (seen_too, same, looked_too), attention = found
    assert seen and seen_too and not looked and looked_too
    np.testing.assert_array_equal(depth, same)
    assert attention.shape[0] > depth.shape[0] and np.any(attention[: len(depth)] != depth)


def test_the_floor_goes_along_with_the_robot_in_whole_tiles(viewer):
    found = []

    def look():
        moment = viewer.moment
        qpos = moment.qpos.copy()
        qpos[:2] = 50.3, -7.1
        viewer.draw(dataclasses.replace(moment, qpos=qpos))
        found.append((np.array(viewer.scene.floor.position), np.array(viewer.scene.world.position)))
        viewer.draw(moment)

    viewer.ask(look)
    until(lambda: found)
    floor, world = found[0]
    np.testing.assert_allclose(floor, [50.0, -8.0, 0.0])
    np.testing.assert_allclose(world, [-50.3, 7.1, 0.0])


def test_a_taken_port_is_one_line(viewer):
    with refusal(f"127.0.0.1:{viewer.port} --port"):
        Viewer(Agent("zero"), "thin", 0, port=viewer.port)


@optional.needs_opengl
def test_a_video_and_a_figure_from_end_to_end(tmp_path):
    """In a process of its own, for MuJoCo picks its OpenGL when it is imported."""
    film, figure = tmp_path / "a.gif", tmp_path / "a.png"
    words = ["--zero", "--seconds", "0.4", "--width", "160", "--columns", "2"]
    command = [sys.executable, "-m", "loco_mjx.cli.main", "play", *words, "--video", str(film), "--figure", str(figure)]
    done = subprocess.run(command, capture_output=True, text=True)
    optional.skip_without_driver(done.stderr)
    assert done.returncode == 0, done.stderr
    assert "fork" not in done.stderr
    frames = imageio.imread(film)
    assert frames.shape[:3] == (10, 90, 160)  # seconds × 25, 16:9
    assert frames[0, :40].std() > 10 and imageio.imread(figure).std() > 10
