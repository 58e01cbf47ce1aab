"""A robot of one's own: the Go2 with 2 kg more in its trunk. Any MJCF with the names that docs/robots.md gives works.

loco-mjx scene --import examples/custom_robot.py --robot go2-loaded --task thin --out loaded.xml
loco-mjx train --import examples/custom_robot.py --robot go2-loaded --task thin
"""

import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import loco_mjx
from loco_mjx.robots import ROBOTS

NAME, LOAD = "go2-loaded", 2.0  # kg
FOLDER = tempfile.TemporaryDirectory()  # as long as the program runs; a file of your own lies beside its module


def loaded() -> Path:
    """Writes the Go2's MJCF with a heavier trunk."""
    tree = ElementTree.parse(ROBOTS["go2"])
    tree.getroot().set("model", NAME)
    inertial = tree.find(".//body[@name='trunk']/inertial")
    assert inertial is not None
    inertial.set("mass", str(float(inertial.get("mass", "0")) + LOAD))
    path = Path(FOLDER.name) / f"{NAME}.xml"
    tree.write(path)
    return path


loco_mjx.register_robot(NAME, loaded())
