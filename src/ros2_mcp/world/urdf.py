"""Parse URDF: a robot's links, its joints with their limits, and their poses.

The format and its defaults: http://wiki.ros.org/urdf/XML. Elements that cannot be read are skipped and reported in
`problems`, because real descriptions are seldom perfect; only text that is not a URDF at all is rejected.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal
from xml.etree import ElementTree

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.text import quoted

MOST_BYTES = 10_000_000
"""Size of one description. That of a humanoid with meshes by name has 0.2 MB; the rest is for embedded data."""
_DEEPEST = 500
"""Joints from a link to the root; deeper trees have loops."""
MOVING = ("revolute", "continuous", "prismatic", "planar", "floating")
KINDS = ("fixed", *MOVING)

Triple = tuple[float, float, float]
Rotation = tuple[Triple, Triple, Triple]
_NOWHERE: Triple = (0.0, 0.0, 0.0)
NO_POSITIONS: Mapping[str, float] = {}


@dataclass(frozen=True, slots=True)
class Mount:
    """A pose in another frame: `xyz` in m, `rpy` in rad about the fixed axes x, y, z, in that order."""

    xyz: Triple = _NOWHERE
    rpy: Triple = _NOWHERE

    def of(self, inner: Mount) -> Mount:
        """Return the pose of `inner`, given in this frame, in the frame in which this mount is given."""
        rotation = _matrix(self.rpy)
        x, y, z = (sum(row[i] * inner.xyz[i] for i in range(3)) for row in rotation)
        turned = _product(rotation, _matrix(inner.rpy))
        return Mount((self.xyz[0] + x, self.xyz[1] + y, self.xyz[2] + z), _angles(turned))


@dataclass(frozen=True, slots=True)
class Geometry:
    """A shape of a link.

    `size` in m is a box's x, y, z; a cylinder's or capsule's radius and length; a sphere's radius; or a mesh's scale.
    `mesh` is the file of a mesh; `rgba` is the colour, each part 0 to 1, None if not given.
    """

    kind: Literal["box", "cylinder", "sphere", "capsule", "mesh"]
    size: Sequence[float]
    mount: Mount
    mesh: str = ""
    rgba: Sequence[float] | None = None


@dataclass(frozen=True, slots=True)
class Link:
    """A rigid body: its visual and collision shapes, and its mass in kg (None if not given)."""

    name: str
    visuals: Sequence[Geometry] = ()
    collisions: Sequence[Geometry] = ()
    mass: float | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one joint: positions in rad (m if prismatic), `velocity` per s, `effort` in N m (N).

    A position is None if it has no limit, the others if the description does not give them. Soft limits of a
    `safety_controller` apply if they are narrower. If a limit is written but is not a number, `known` is false and both
    positions are 0, so that no motion is allowed.
    """

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    effort: float | None = None
    known: bool = True


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: `multiplier` times its position, plus `offset`."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """The pose of `child` in `parent`, and the `axis` (in the joint's frame) about or along which it moves."""

    name: str
    kind: str
    parent: str
    child: str
    mount: Mount = Mount()
    axis: Triple = (1.0, 0.0, 0.0)
    limits: Limits = Limits()
    mimic: Mimic | None = None

    @property
    def moves(self) -> bool:
        """Whether it moves on its own: not fixed, and not a mimic of another joint."""
        return self.kind in MOVING and self.mimic is None

    def at(self, position: float) -> Mount:
        """Return the pose of `child` in `parent` when the joint is at this position (in its `unit`)."""
        if self.kind == "prismatic":
            x, y, z = (part * position for part in self.axis)
            return self.mount.of(Mount((x, y, z)))
        if self.kind in ("revolute", "continuous"):
            return self.mount.of(Mount(rpy=_angles(_about(self.axis, position))))
        return self.mount

    @property
    def unit(self) -> str:
        """The unit of its position."""
        return "m" if self.kind == "prismatic" else "rad"


@dataclass(frozen=True, slots=True, kw_only=True)
class Urdf:
    """A robot's description. `root` is the link without a parent; "" if there are several, or none."""

    name: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    root: str
    problems: Sequence[str] = ()
    controlled: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    """Joints of `<ros2_control>` with their command interfaces, such as `position`."""

    @property
    def moving(self) -> Sequence[Joint]:
        """The moving joints, in the order of the description."""
        return [joint for joint in self.joints.values() if joint.moves]

    def above(self, link: str) -> Joint | None:
        """Return the joint that holds a link; None for a root."""
        return next((joint for joint in self.joints.values() if joint.child == link), None)

    def mount(self, link: str, within: str = "", positions: Mapping[str, float] = NO_POSITIONS) -> Mount | None:
        """Return the pose of a link in another link above it (default: the root); None if it is not below that link.

        `positions` are those of joints by name, in their units; every other joint is at 0 (see `moved_by`).
        """
        way = self._way(link, within)
        if way is None:
            return None
        mount = Mount()
        for joint in way:
            mount = joint.at(self.position(joint, positions) or 0.0).of(mount)
        return mount

    def moved_by(self, link: str, within: str = "") -> Sequence[Joint]:
        """Return the joints that move a link relative to one above it (default: the root), the nearest first."""
        return [joint for joint in self._way(link, within) or () if joint.kind != "fixed"]

    def position(self, joint: Joint, positions: Mapping[str, float]) -> float | None:
        """Return the position of a joint, also of a mimic; None if it is not given, or is more than one number."""
        if joint.kind in ("planar", "floating"):
            return None
        if joint.mimic is None or joint.name in positions:
            return positions.get(joint.name)
        followed = positions.get(joint.mimic.joint)
        return None if followed is None else joint.mimic.multiplier * followed + joint.mimic.offset

    def way_up(self, link: str) -> Sequence[Joint]:
        """Return the joints from a link up to the root, moving or not, the nearest first."""
        return self._way(link, "") or ()

    def _way(self, link: str, within: str) -> list[Joint] | None:
        """Return the joints from a link up to another link (default: the root); None if the link is not below it."""
        way: list[Joint] = []
        for _ in range(_DEEPEST):
            joint = self.above(link)
            if link == within or (not within and joint is None):
                return way if link in self.links else None
            if joint is None:
                return None
            way.append(joint)
            link = joint.parent
        return None

    def fixed_to(self, link: str) -> str:
        """Return the link to which this link is rigidly attached: the highest link above it without a moving joint."""
        for _ in range(_DEEPEST):
            joint = self.above(link)
            if joint is None or joint.kind != "fixed":
                break
            link = joint.parent
        return link


def parse(text: str) -> Urdf:
    """Parse a description.

    Raises:
        BadData: if it is not a URDF: invalid XML, with a document type (whose entities could grow without bound), too
            long, or without any link.
    """
    if len(text) > MOST_BYTES:
        raise BadData(f"The robot description has {len(text)} characters; at most {MOST_BYTES} are read.")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise BadData("The robot description declares a document type and was rejected; a URDF needs none.")
    try:
        root = ElementTree.fromstring(text.encode(errors="replace"))
    except ElementTree.ParseError as error:
        raise BadData(f"The robot description is not valid XML: {error}.") from error
    if root.tag != "robot":
        raise BadData(f"The robot description begins with {quoted(root.tag)}; a URDF begins with robot.")
    problems: list[str] = []
    colours = {one.get("name", ""): colour for one in root.findall("material") if (colour := _rgba(one))}
    links = {link.name: link for element in root.findall("link") if (link := _link(element, problems, colours))}
    if not links:
        raise BadData("The robot description has no link.")
    joints = {joint.name: joint for element in root.findall("joint") if (joint := _joint(element, links, problems))}
    children = [joint.child for joint in joints.values()]
    problems += [f"{quoted(name)} has several parents" for name in links if children.count(name) > 1]
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        shown = ", ".join(map(quoted, roots[:5]))
        problems.append(f"{len(roots)} links have no parent: {shown}" if roots else "every link has a parent")
    return Urdf(
        name=root.get("name", ""),
        links=links,
        joints=joints,
        root=roots[0] if len(roots) == 1 else "",
        problems=problems,
        controlled=dict(_controlled(root)),
    )


def _link(element: ElementTree.Element, problems: list[str], colours: Mapping[str, Sequence[float]]) -> Link | None:
    name = element.get("name", "")
    if not name:
        problems.append("a link has no name")
        return None
    mass = element.find("inertial/mass")
    return Link(
        name,
        [
            replace(shape, rgba=_colour(part, colours))
            for part in element.findall("visual")
            if (shape := _geometry(part, name, problems))
        ],
        [shape for part in element.findall("collision") if (shape := _geometry(part, name, problems))],
        None if mass is None else _number(mass, "value", name, problems),
    )


def _colour(visual: ElementTree.Element, colours: Mapping[str, Sequence[float]]) -> Sequence[float] | None:
    """Return the colour of the visual's own material, or of the material that it names."""
    material = visual.find("material")
    return None if material is None else _rgba(material) or colours.get(material.get("name", ""))


def _rgba(material: ElementTree.Element) -> Sequence[float] | None:
    colour = material.find("color")
    numbers = [_float(word) for word in ("" if colour is None else colour.get("rgba", "")).split()]
    found = [min(max(number, 0.0), 1.0) for number in numbers if number is not None]
    return found if len(found) == len(numbers) == 4 else None


def _geometry(part: ElementTree.Element, link: str, problems: list[str]) -> Geometry | None:
    mount = _mount(part, link, problems)
    for shape in part.findall("geometry/*"):
        if shape.tag == "box":
            return Geometry("box", _triple(shape, "size", _NOWHERE, link, problems), mount)
        if shape.tag in ("cylinder", "capsule"):
            radius, length = (_number(shape, each, link, problems) or 0.0 for each in ("radius", "length"))
            return Geometry("cylinder" if shape.tag == "cylinder" else "capsule", (radius, length), mount)
        if shape.tag == "sphere":
            return Geometry("sphere", (_number(shape, "radius", link, problems) or 0.0,), mount)
        if shape.tag == "mesh":
            scale = _triple(shape, "scale", (1.0, 1.0, 1.0), link, problems)
            return Geometry("mesh", scale, mount, shape.get("filename", ""))
    problems.append(f"a shape of {quoted(link)} is of an unknown kind")
    return None


def _joint(element: ElementTree.Element, links: Mapping[str, Link], problems: list[str]) -> Joint | None:
    name, kind = element.get("name", ""), element.get("type", "")
    parent, child = (
        "" if end is None else end.get("link", "") for end in (element.find("parent"), element.find("child"))
    )
    if not name or kind not in KINDS:
        problems.append(f"the joint {quoted(name)} has the unknown type {quoted(kind)}")
        return None
    if missing := [end for end in (parent, child) if end not in links]:
        problems.append(f"the joint {quoted(name)} refers to {quoted(missing[0])}, which is not a link")
        return None
    follows = element.find("mimic")
    mimic = None
    if follows is not None:
        factor, offset = (_number(follows, each, name, problems) for each in ("multiplier", "offset"))
        mimic = Mimic(follows.get("joint", ""), 1.0 if factor is None else factor, offset or 0.0)
    axis = element.find("axis")
    return Joint(
        name,
        kind,
        parent,
        child,
        _mount(element, name, problems),
        (1.0, 0.0, 0.0) if axis is None else _triple(axis, "xyz", (1.0, 0.0, 0.0), name, problems),
        _limits(element, kind, name, problems),
        mimic,
    )


def _limits(element: ElementTree.Element, kind: str, name: str, problems: list[str]) -> Limits:
    """Parse the limits of a joint. A missing bound is 0, by the format; a continuous joint has none."""
    limit, soft = element.find("limit"), element.find("safety_controller")
    if limit is None:
        if kind in ("revolute", "prismatic"):
            problems.append(f"the joint {quoted(name)} has no limits")
        return Limits()
    velocity, effort = (_number(limit, each, name, problems) for each in ("velocity", "effort"))
    if kind not in ("revolute", "prismatic"):
        return Limits(velocity=velocity, effort=effort)
    bounds = {each: _number(limit, each, name, problems) for each in ("lower", "upper")}
    if any(limit.get(each) is not None and bound is None for each, bound in bounds.items()):
        return Limits(0.0, 0.0, velocity, effort, known=False)
    lower, upper = (bound or 0.0 for bound in bounds.values())
    if soft is not None:
        softest = [_number(soft, f"soft_{each}_limit", name, problems) for each in ("lower", "upper")]
        lower = lower if softest[0] is None else max(lower, softest[0])
        upper = upper if softest[1] is None else min(upper, softest[1])
    if lower > upper:
        problems.append(f"the joint {quoted(name)} has a lower limit above its upper one")
    return Limits(lower, upper, velocity, effort)


def _controlled(root: ElementTree.Element) -> Iterator[tuple[str, Sequence[str]]]:
    for joint in root.findall("ros2_control/joint"):
        yield joint.get("name", ""), [each.get("name", "") for each in joint.findall("command_interface")]


def _mount(element: ElementTree.Element, name: str, problems: list[str]) -> Mount:
    origin = element.find("origin")
    if origin is None:
        return Mount()
    return Mount(*(_triple(origin, each, _NOWHERE, name, problems) for each in ("xyz", "rpy")))


def _triple(element: ElementTree.Element, key: str, default: Triple, name: str, problems: list[str]) -> Triple:
    words = (element.get(key) or "").split()
    if not words:
        return default
    numbers = [_float(word) for word in words]
    if len(numbers) != 3 or None in numbers:
        problems.append(f"{key} of {quoted(name)} is {quoted(' '.join(words))}, not three numbers")
        return default
    x, y, z = (number or 0.0 for number in numbers)
    return x, y, z


def _number(element: ElementTree.Element, key: str, name: str, problems: list[str]) -> float | None:
    word = element.get(key)
    if word is None:
        return None
    number = _float(word)
    if number is None:
        problems.append(f"{key} of {quoted(name)} is {quoted(word)}, not a number")
    return number


def _float(word: str) -> float | None:
    try:
        number = float(word)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _matrix(rpy: Triple) -> Rotation:
    """Return the matrix Rz(yaw) Ry(pitch) Rx(roll)."""
    (a, b, c), (d, e, f) = map(math.sin, rpy), map(math.cos, rpy)
    return (
        (f * e, f * b * a - c * d, f * b * d + c * a),
        (c * e, c * b * a + f * d, c * b * d - f * a),
        (-b, e * a, e * d),
    )


def _about(axis: Triple, angle: float) -> Rotation:
    """Return the rotation about an axis, of any length but 0, by an angle in rad (Rodrigues)."""
    length = math.hypot(*axis) or 1.0
    x, y, z = (part / length for part in axis)
    c, s, rest = math.cos(angle), math.sin(angle), 1.0 - math.cos(angle)
    return (
        (c + x * x * rest, x * y * rest - z * s, x * z * rest + y * s),
        (y * x * rest + z * s, c + y * y * rest, y * z * rest - x * s),
        (z * x * rest - y * s, z * y * rest + x * s, c + z * z * rest),
    )


def _product(left: Rotation, right: Rotation) -> Rotation:
    rows = [tuple(sum(row[k] * right[k][column] for k in range(3)) for column in range(3)) for row in left]
    return rows[0], rows[1], rows[2]  # pyright: ignore[reportReturnType] - three of three


def _angles(rotation: Rotation) -> Triple:
    """Return roll, pitch and yaw of a rotation; with the pitch at ±90° the roll is 0."""
    pitch = math.atan2(-rotation[2][0], math.hypot(rotation[0][0], rotation[1][0]))
    if math.hypot(rotation[0][0], rotation[1][0]) < 1e-9:  # gimbal lock: yaw and roll turn about the same axis
        return 0.0, pitch, math.atan2(-rotation[0][1], rotation[1][1])
    return math.atan2(rotation[2][1], rotation[2][2]), pitch, math.atan2(rotation[1][0], rotation[0][0])
