"""A computer that lacks what the depth camera needs: one line that says what to install."""

import sys

import pytest

from loco_mjx.deploy.realsense import RealSense
from loco_mjx.errors import UserError
from tests.deploy import flat


@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("raise ModuleNotFoundError('no module', name='pyrealsense2')", r"needs pyrealsense2: pip install .*\[a1\]"),
        (
            "raise ImportError('libusb-1.0.so.0: cannot open shared object file: No such file or directory')",
            "needs libusb: apt-get install libusb-1.0-0$",
        ),
        ("raise ImportError('libudev.so.1: cannot open shared object file')", "cannot be loaded: libudev.so.1"),
    ],
)
def test_what_is_missing_is_named_with_the_line_that_installs_it(package, words, tmp_path, monkeypatch):
    (tmp_path / "pyrealsense2.py").write_text(package)
    monkeypatch.delitem(sys.modules, "pyrealsense2", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError, match=words) as raised:
        RealSense(flat.manifest().camera, now=lambda: 0.0)
    assert "\n" not in str(raised.value)
