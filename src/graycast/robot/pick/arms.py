"""The built-in robots, drawn by us as capsules and boxes from published dimensions.

UR5e: Denavit-Hartenberg table, limits and speeds of Universal Robots' data sheet. Diana 7 (Agile
Robots): joint origins and limits as stated with the paper's cell; the joints' directions are those
that make a stretched arm stand upright with its flange looking down, as the maker shows it.
Accelerations are ours: neither maker states them.
"""

from dataclasses import dataclass
from math import atan2, hypot, pi, sqrt
from typing import NamedTuple
from xml.etree import ElementTree as xml

Real = float | int
Triple = tuple[Real, Real, Real]


class _Capsule(NamedTuple):
    """Between two points of a link's frame [m]."""

    start: Triple
    end: Triple
    radius: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Joint:
    """A turning joint about its z, where it sits on the link before, and the link that it turns."""

    origin: Triple
    rpy: Triple = (0.0, 0.0, 0.0)
    low: Real
    high: Real
    speed: float
    link: tuple[_Capsule, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """A serial robot. `flange` is the tool's mounting face on the last link, z outwards."""

    name: str
    base: tuple[_Capsule, ...]
    joints: tuple[_Joint, ...]
    flange: Triple
    home: tuple[Real, ...]


_UR5E = Arm(
    name="ur5e",
    base=(_Capsule((0, 0, 0.03), (0, 0, 0.06), 0.07),),
    joints=(
        _Joint(
            origin=(0, 0, 0.1625), low=-2 * pi, high=2 * pi, speed=pi,
            link=(_Capsule((0, 0, -0.03), (0, -0.09, 0.0), 0.06),),
        ),
        _Joint(
            origin=(0, 0, 0), rpy=(pi / 2, 0, 0), low=-2 * pi, high=2 * pi, speed=pi,
            link=(_Capsule((0, 0, 0.138), (-0.425, 0, 0.138), 0.055),),
        ),
        _Joint(
            origin=(-0.425, 0, 0), low=-pi, high=pi, speed=pi,
            link=(_Capsule((0, 0, 0.02), (-0.3922, 0, 0.02), 0.045),),
        ),
        _Joint(
            origin=(-0.3922, 0, 0.1333), low=-2 * pi, high=2 * pi, speed=pi,
            link=(_Capsule((0, 0, -0.03), (0, -0.02, 0.0), 0.042),),
        ),
        _Joint(
            origin=(0, 0, 0), rpy=(pi / 2, 0, 0), low=-2 * pi, high=2 * pi, speed=pi,
            link=(_Capsule((0, 0, 0.06), (0, 0, 0.0997), 0.042),),
        ),
        _Joint(
            origin=(0, 0, 0.0997), rpy=(-pi / 2, 0, 0), low=-2 * pi, high=2 * pi, speed=pi,
            link=(_Capsule((0, 0, 0.05), (0, 0, 0.06), 0.038),),
        ),
    ),
    flange=(0, 0, 0.0996),
    home=(0.0, -pi / 2, pi / 2, -pi / 2, -pi / 2, 0.0),
)  # fmt: skip

_SIDE = 3.12
_DIANA7 = Arm(
    name="diana7",
    base=(_Capsule((0, 0, 0.05), (0, 0, 0.15), 0.085),),
    joints=(
        _Joint(
            origin=(0, 0, 0.2856), low=-_SIDE, high=_SIDE, speed=2.618,
            link=(_Capsule((0, 0, -0.1), (0, 0, 0), 0.075),),
        ),
        _Joint(
            origin=(0, 0, 0), rpy=(-pi / 2, 0, 0), low=-pi / 2, high=pi / 2, speed=2.618,
            link=(_Capsule((0, 0, 0), (0, -0.2, 0), 0.075),),
        ),
        _Joint(
            origin=(0, -0.4586, 0), rpy=(pi / 2, 0, 0), low=-_SIDE, high=_SIDE, speed=2.618,
            link=(_Capsule((0, 0, -0.2), (0, 0, 0), 0.065),),
        ),
        _Joint(
            origin=(0.065, 0, 0), rpy=(-pi / 2, 0, 0), low=0.0, high=3.05, speed=2.618,
            link=(_Capsule((0, 0, 0), (-0.05, -0.2, 0), 0.065),),
        ),
        _Joint(
            origin=(-0.0528, -0.47702, 0), rpy=(pi / 2, 0, 0), low=-_SIDE, high=_SIDE, speed=pi,
            link=(_Capsule((0, 0, -0.22), (0, 0, -0.02), 0.055),),
        ),
        _Joint(
            origin=(-0.0122, 0, -0.0216), rpy=(-pi / 2, 0, 0), low=-_SIDE, high=_SIDE, speed=pi,
            link=(_Capsule((0, 0, 0), (0.087, 0, 0), 0.05),),
        ),
        _Joint(
            origin=(0.087, 0.1169, 0), rpy=(-pi / 2, 0, 0), low=-_SIDE, high=_SIDE, speed=pi,
            link=(_Capsule((0, 0, -0.06), (0, 0, -0.04), 0.045),),
        ),
    ),
    flange=(0, 0, 0),
    home=(0.0, -0.2, 0.0, pi / 2, 0.0, 0.2 - pi / 2, 0.0),
)  # fmt: skip

ARMS = {arm.name: arm for arm in (_UR5E, _DIANA7)}


def urdf(arm: Arm) -> str:
    """Return the arm as a URDF file's text; its last link is `flange`."""
    robot = xml.Element("robot", name=arm.name)
    _add_link(robot, "base", arm.base)
    parent = "base"
    for number, joint in enumerate(arm.joints, 1):
        child = f"link{number}"
        _add_link(robot, child, joint.link)
        element = xml.SubElement(robot, "joint", name=f"joint{number}", type="revolute")
        xml.SubElement(element, "parent", link=parent)
        xml.SubElement(element, "child", link=child)
        xml.SubElement(element, "origin", xyz=_text(joint.origin), rpy=_text(joint.rpy))
        xml.SubElement(element, "axis", xyz="0 0 1")
        xml.SubElement(
            element, "limit", lower=repr(joint.low), upper=repr(joint.high),
            velocity=repr(joint.speed), effort="0",
        )  # fmt: skip
        parent = child
    _add_link(robot, "flange", ())
    fixed = xml.SubElement(robot, "joint", name="to_flange", type="fixed")
    xml.SubElement(fixed, "parent", link=parent)
    xml.SubElement(fixed, "child", link="flange")
    xml.SubElement(fixed, "origin", xyz=_text(arm.flange), rpy="0 0 0")
    return xml.tostring(robot, encoding="unicode")


def _add_link(robot: xml.Element, name: str, capsules: tuple[_Capsule, ...]) -> None:
    """A capsule is a cylinder between two balls: URDF has no capsule."""
    link = xml.SubElement(robot, "link", name=name)
    for capsule in capsules:
        for xyz in (capsule.start, capsule.end):
            ball = xml.SubElement(link, "collision")
            xml.SubElement(ball, "origin", xyz=_text(xyz), rpy="0 0 0")
            xml.SubElement(xml.SubElement(ball, "geometry"), "sphere", radius=repr(capsule.radius))
        middle, rpy, length = _between(capsule)
        if length > 0:
            tube = xml.SubElement(link, "collision")
            xml.SubElement(tube, "origin", xyz=_text(middle), rpy=_text(rpy))
            xml.SubElement(
                xml.SubElement(tube, "geometry"), "cylinder",
                radius=repr(capsule.radius), length=repr(length),
            )  # fmt: skip


def _between(capsule: _Capsule) -> tuple[Triple, Triple, float]:
    """Middle, roll-pitch-yaw that turns z onto the capsule's line, and its length."""
    a, b = capsule.start, capsule.end
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2)
    return middle, (0.0, atan2(hypot(x, y), z), atan2(y, x)), sqrt(x * x + y * y + z * z)


def _text(values: Triple) -> str:
    return " ".join(repr(float(value)) for value in values)
