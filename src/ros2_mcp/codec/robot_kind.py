"""What kind of robot a description and its command inputs speak of."""

from __future__ import annotations

import re
from collections.abc import Collection

from ros2_mcp.codec.urdf import Joint, Urdf

_LEGS = re.compile(r"(hip|thigh|calf|knee|ankle|haa|hfe|kfe)", re.IGNORECASE)
_LEAST_LEGS = 6
"""Joints of legs: two legs with three each; an arm on a base has no hip."""
_STEERED = re.compile(r"(steer|steering)", re.IGNORECASE)
_OMNI = re.compile(r"(mecanum|omni|swerve|holonomic)", re.IGNORECASE)
_GRIPPER = re.compile(r"(gripper|finger|knuckle|jaw)", re.IGNORECASE)
_ROTOR = re.compile(r"(rotor|propeller|\bprop)", re.IGNORECASE)
_LEAST_ROTORS = 3
_LEAST_ARM = 4
"""Joints one after the other: a pan-tilt head has two, a lift with a gripper three."""


def wheels_of(urdf: Urdf) -> list[Joint]:
    """The joints that turn without end and hold a wheel: so named, or with a round shape and nothing moving below."""
    found: list[Joint] = []
    held = {joint.parent for joint in urdf.moving}
    for joint in urdf.joints.values():
        if joint.kind != "continuous":
            continue
        link = urdf.links.get(joint.child)
        shapes = [*link.collisions, *link.visuals] if link else []
        is_named = "wheel" in f"{joint.name} {joint.child}".lower()
        is_round = joint.child not in held and any(shape.kind in ("cylinder", "sphere") for shape in shapes)
        if is_named or is_round:
            found.append(joint)
    return found


def legs_of(urdf: Urdf) -> list[Joint]:
    """The joints of legs; none where there are too few of them for two legs."""
    found = [joint for joint in urdf.moving if _LEGS.search(joint.name)]
    return found if len(found) >= _LEAST_LEGS else []


def rotors_of(urdf: Urdf) -> list[Joint]:
    """The joints that turn rotors; nobody tells or asks for their positions."""
    return [joint for joint in urdf.moving if _ROTOR.search(f"{joint.name} {joint.child}")]


def arm_of(urdf: Urdf) -> list[Joint]:
    """The longest chain of joints that are no wheels, without those of a gripper."""
    wheels = {joint.name for joint in wheels_of(urdf)}
    best: list[Joint] = []
    for link in urdf.links:
        chain: list[Joint] = []
        seen, at = set[str](), link
        while (joint := urdf.above(at)) and joint.name not in seen:
            seen.add(joint.name)
            if joint.moves and joint.name not in wheels and not _GRIPPER.search(joint.name):
                chain.append(joint)
            at = joint.parent
        if len(chain) > len(best):
            best = chain[::-1]
    while best and _is_lift(urdf, best[0]):
        best = best[1:]
    return best


def _is_lift(urdf: Urdf, joint: Joint) -> bool:
    """Whether it lifts a torso: it slides, and more than the arm hangs from it, such as a head."""
    body = urdf.fixed_to(joint.child)
    return joint.kind == "prismatic" and sum(urdf.fixed_to(other.parent) == body for other in urdf.moving) > 1


def kind_of(urdf: Urdf | None, driven_by: Collection[str], stacks: Collection[str]) -> str:
    """In words, from the description (None: there is none), the types of the command inputs, and what runs on it."""
    rotors = len(rotors_of(urdf)) if urdf else 0
    flies = bool(urdf and re.search(r"(quad|multi|hexa|octo)(rotor|copter)|drone|uav", urdf.name, re.IGNORECASE))
    flies |= "MAVROS" in stacks or any("Multirotor" in kind or "MultiDOF" in kind for kind in driven_by)
    if flies or rotors >= _LEAST_ROTORS:
        return f"drone, {rotors} rotors" if rotors else "drone"
    if urdf and legs_of(urdf):
        legs = len([joint for joint in urdf.moving if re.search(r"(calf|knee|kfe)", joint.name, re.IGNORECASE)])
        return f"legged robot, {legs} legs" if legs else "legged robot"
    base = _base(urdf, driven_by)
    arm = arm_of(urdf) if urdf else []
    if len(arm) >= _LEAST_ARM:
        has_gripper = urdf and any(_GRIPPER.search(joint.name) for joint in urdf.moving)
        joints = f"arm of {len(arm)} joints{' and a gripper' if has_gripper else ''}"
        return f"{base} with an {joints}" if base else joints
    return base or "unknown"


def _base(urdf: Urdf | None, driven_by: Collection[str]) -> str:
    """What it drives on; empty where it does not."""
    drives = any(kind.rpartition("/")[2].startswith("Twist") for kind in driven_by)
    if any("Ackermann" in kind for kind in driven_by):
        return "car-like base"
    if urdf is None:
        return "base driven by velocities" if drives else ""
    wheels = [joint.name for joint in wheels_of(urdf)]
    steered = [joint for joint in urdf.moving if _STEERED.search(joint.name) and joint.kind == "revolute"]
    words = " ".join([urdf.name, *wheels, *(joint.child for joint in wheels_of(urdf)), *urdf.controlled])
    driven = [name for name in wheels if not re.search(r"caster|castor", name, re.IGNORECASE)]
    if steered:
        return f"car-like base, {len(driven)} wheels"
    if len(driven) >= 3 and _OMNI.search(words):
        return f"omnidirectional base, {len(driven)} wheels"
    if len(driven) == 2:
        return "differential drive base, 2 wheels"
    if len(driven) >= 4:
        return f"skid-steered base, {len(driven)} wheels"
    if len(driven) == 3:
        return "omnidirectional base, 3 wheels"
    return "base driven by velocities" if drives else ""
