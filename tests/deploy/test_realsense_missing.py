"""A computer that lacks what the depth camera needs: one line that says what to install."""

import sys

import pytest

from loco_mjx.deploy.realsense import RealSense
from tests.deploy import flat
from tests.refusals import refusal


@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("raise ModuleNotFoundError('no module', name='pyrealsense2')", "pyrealsense2 pip install 'loco-mjx[a1]'"),
        (
            "raise ImportError('libusb-1.0.so.0: cannot open shared object file: No such file or directory')",
            "libusb apt-get install libusb-1.0-0",
        ),
        ("raise ImportError('libudev.so.1: cannot open shared object file')", "pyrealsense2 libudev.so.1"),
    ],
)
def test_what_is_missing_is_named_with_the_line_that_installs_it(package, words, tmp_path, monkeypatch):
    (tmp_path / "pyrealsense2.py").write_text(package)
    monkeypatch.delitem(sys.modules, "pyrealsense2", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with refusal(words) as raised:
        RealSense(flat.manifest().camera, now=lambda: 0.0)
    assert "\n" not in str(raised.value)
