"""An MJCF file's elements with their default classes resolved: as much of the format as a robot's parts take."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from loco_mjx.errors import UserError

TURNS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
UPRIGHT = {"quat": (1.0, 0.0, 0.0, 0.0), "euler": (0.0, 0.0, 0.0)}
MAIN = "main"  # the class of elements that name none
Defaults = dict[str, dict[str, dict[str, str]]]  # attributes by class and tag


class Element:
    """One element, and what its class says of the attributes that it does not give."""

    def __init__(self, element: ElementTree.Element, known: dict[str, str], parent: str, document: Document) -> None:
        """`known` is what its class says, `parent` the name of the body that holds it."""
        self.tag, self.parent = element.tag, parent
        self._element, self._attributes, self._document = element, known | dict(element.attrib), document

    @property
    def name(self) -> str:
        """Its name; empty if it has none."""
        return self._attributes.get("name", "")

    def __str__(self) -> str:
        return f"{self.tag} '{self.name}'"

    def get(self, attribute: str, default: str | None = None) -> str | None:
        """An attribute's text."""
        return self._attributes.get(attribute, default)

    def children(self, *tags: str) -> list[Element]:
        """The elements directly in it that have one of some tags."""
        return [one for one in self._document.elements if one.tag in tags and self.holds(one)]

    def holds(self, other: Element) -> bool:
        """Whether another element is directly in it."""
        return any(child is other._element for child in self._element)

    def numbers(self, attribute: str, count: int | None, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """An attribute's numbers.

        Raises:
            UserError: if there are not so many, or none and no default.
        """
        text = self.get(attribute)
        if text is None and default is not None:
            return default
        try:
            values = tuple(float(word) for word in (text or "").split())
        except ValueError:
            values = ()
        if (count is not None and len(values) != count) or not all(map(math.isfinite, values)):
            raise UserError(f"{self} has {attribute} {text!r:.60}; accepted: {count} numbers")
        return values

    def number(self, attribute: str, default: float) -> float:
        """An attribute's first number."""
        return self.numbers(attribute, None, (default,))[0]

    def limits(self, angle: float) -> tuple[float, float]:
        """A joint's range, rad; `angle` is the file's unit.

        Raises:
            UserError: if it has none.
        """
        low, high = self.numbers("range", 2)
        if not low < high or self.get("limited", "auto") == "false":
            raise UserError(f"{self} has range {low:g} {high:g}; accepted: its two limits, the lower first")
        return low * angle, high * angle

    def radius(self) -> float:
        """A sphere's radius, m.

        Raises:
            UserError: if it is no sphere.
        """
        if self.get("type", "sphere") != "sphere" or self.get("fromto") is not None:
            raise UserError(f"{self} is a {self.get('type')}; accepted: a sphere")
        radius = self.number("size", 0.0)
        if radius <= 0:
            raise UserError(f"{self} has size {radius:g}; accepted: its radius, more than 0")
        return radius

    def turned(self) -> str | None:
        """The attribute that turns it against its parent; None if none does."""
        for name in TURNS:
            if self.get(name) is not None and self.numbers(name, None) != UPRIGHT.get(name):
                return f'{name}="{self.get(name)}"'
        return None


class Document:
    """One file.

    Attributes:
        path: of it.
        model: its name.
        elements: all of them, in order.
        angle: its unit of joint ranges, rad.
        timestep: s.
    """

    def __init__(self, path: Path) -> None:
        """Reads it.

        Raises:
            UserError: if it is no MJCF.
        """
        try:
            root = ElementTree.parse(path).getroot()
        except (OSError, ElementTree.ParseError) as error:
            raise UserError(f"it cannot be read ({error})") from None
        if root.tag != "mujoco":
            raise UserError(f"its root is <{root.tag}>; accepted: <mujoco>")
        if next(root.iter("include"), None) is not None:
            raise UserError("it includes another file; accepted: all in one")
        self.path, self.model = path, root.get("model", path.stem)
        self._defaults: Defaults = {MAIN: {}}
        for section in root.findall("default"):
            self._learn(section, MAIN)
        self.elements = list(self._walk(root, "", MAIN))
        compiler = self._only("compiler")
        self.angle = 1.0 if compiler.get("angle") == "radian" else math.pi / 180
        self.timestep = float(self._only("option").get("timestep", "0.002"))

    def _only(self, tag: str) -> dict[str, str]:
        """All attributes of the sections of a tag, together."""
        return {name: value for one in self.elements if one.tag == tag for name, value in one._attributes.items()}

    def _learn(self, section: ElementTree.Element, above: str) -> None:
        """A default class takes over what the one above says."""
        name = section.get("class", above)
        known = self._defaults.setdefault(name, {tag: dict(of) for tag, of in self._defaults[above].items()})
        for child in section:
            if child.tag != "default":
                known[child.tag] = known.get(child.tag, {}) | dict(child.attrib)
        for child in section.findall("default"):
            self._learn(child, name)

    def _walk(self, element: ElementTree.Element, body: str, inherited: str) -> Iterator[Element]:
        for child in element:
            if child.tag == "default":
                continue
            name = child.get("class", inherited)
            if name not in self._defaults:
                raise UserError(f"{child.tag} '{child.get('name', '')}' has class '{name}', which is not there")
            yield Element(child, self._defaults[name].get(child.tag, {}), body, self)
            if child.tag == "body":
                yield from self._walk(child, child.get("name", ""), child.get("childclass", inherited))
            else:
                yield from self._walk(child, body, inherited)

    def all(self, tag: str) -> list[Element]:
        """The elements of a tag in the bodies."""
        return [one for one in self.elements if one.tag == tag and one.parent]

    def all_in(self, section: str) -> list[Element]:
        """The elements directly in a section."""
        return [one for held in self.elements if held.tag == section for one in self.elements if held.holds(one)]

    def named(self, tag: str, name: str) -> Element:
        """The element of a tag that has a name.

        Raises:
            UserError: if there is none.
        """
        for one in self.elements:
            if one.tag == tag and one.name == name:
                return one
        raise UserError(f"it has no {tag} '{name}'")

    def custom(self, name: str, count: int) -> tuple[float, ...]:
        """Numbers that MuJoCo itself has no word for: ``<custom><numeric name="kp" data="40"/></custom>``.

        Raises:
            UserError: if they are missing, or not so many.
        """
        values = self.named("numeric", name).numbers("data", count)
        if any(value < 0 for value in values):
            raise UserError(f"numeric '{name}' has data {values}; accepted: 0 or more")
        return values
