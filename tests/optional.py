"""Libraries of the system that a bare machine lacks: a test that needs one is skipped, saying what to install."""

from __future__ import annotations

import ctypes.util
import shutil
from typing import Any

import pytest

OPENGL = "apt-get install libegl1 libopengl0 libgl1-mesa-dri"
LIBUSB = "apt-get install libusb-1.0-0"
CHROMIUM = "apt-get install chromium"
REALSENSE = "pip install 'loco-mjx[a1]'"

needs_opengl = pytest.mark.skipif(
    not all(map(ctypes.util.find_library, ("EGL", "OpenGL"))), reason=f"no OpenGL: {OPENGL}"
)


def skip_without_driver(stderr: str) -> None:
    """Skips a test whose process found OpenGL, but no driver of it."""
    if "needs OpenGL" in stderr:
        pytest.skip(f"OpenGL without a driver: {OPENGL}")


def chromium() -> str:
    """The browser's path, or the test is skipped."""
    path = shutil.which("chromium")
    if path is None:
        pytest.skip(f"no Chromium: {CHROMIUM}")
    return path


def pyrealsense2() -> Any:
    """The module, or the whole file is skipped."""
    try:
        import pyrealsense2 as module
    except ModuleNotFoundError:
        pytest.skip(f"no pyrealsense2 (not every platform has a wheel): {REALSENSE}", allow_module_level=True)
    except ImportError as error:
        if "libusb" not in str(error):
            raise
        pytest.skip(f"no libusb, which pyrealsense2 needs: {LIBUSB}", allow_module_level=True)
    return module
