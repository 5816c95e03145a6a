"""Classify a robot by its description, its controllers and its command topics."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence

from ros2_mcp.world.urdf import Joint, Urdf

_LEGS = re.compile(
    r"(hip|thigh|calf|knee|ankle|shank|[ul](pp|ow)?(er)?_?leg|haa|hfe|kfe|_h[xy]$|_kn$|coxa|femur|tibia)", re.IGNORECASE
)
_LEAST_LEGS = 6
"""Least number of leg joints: two legs with three each. An arm on a base has no hip."""
_STEERED = re.compile(r"steer", re.IGNORECASE)
_CASTER = re.compile(r"(cast[eo]r|swivel)", re.IGNORECASE)
_OMNI = re.compile(r"(mecanum|omni|swerve|holonomic|(?<![a-z])roller)", re.IGNORECASE)
_NOT_SIDEWAYS = re.compile(r"diff_?drive", re.IGNORECASE)
"""A controller that drives the wheels of each side alike, whatever the names of the wheels."""
_CAR = re.compile(r"(ackermann|bicycle|tricycle|steering)", re.IGNORECASE)
_GRIPPER = re.compile(r"(gripper|finger|fngr|knuckle|jaw|claw|(?<![a-z])[lr]?hand(_joint)?$)", re.IGNORECASE)
_ROTOR = re.compile(r"(rotor|propeller|(?<![a-z])prop(?![a-z]))", re.IGNORECASE)
_THRUSTER = re.compile(r"thruster", re.IGNORECASE)
_NO_WHEEL = re.compile(r"(propeller|thruster|rotor|engine|(?<![a-z])(prop|screw|fan)(?![a-z]))", re.IGNORECASE)
"""Round, turning without limit, but not a wheel."""
_TORSO = re.compile(r"torso", re.IGNORECASE)
_FLYING = re.compile(r"((quad|multi|hexa|octo)(rotor|copter)|drone|uav|crazyflie)", re.IGNORECASE)
_WINGS = re.compile(r"(aileron|elevon)", re.IGNORECASE)
"""Surfaces that only wings have; boats have rudders, too."""
_TRACK = re.compile(r"(?<![a-z])(tracks?|crawler|caterpillar)(?![a-z])", re.IGNORECASE)
_LEAST_ROTORS = 3
_LEAST_ARM = 4
"""Joints in a chain: a pan-tilt head has two, a lift with a gripper three."""
_LEAST_LIMBS = 3
"""With this many long chains they may not all be arms; only names could tell."""
_UPRIGHT = 0.9
"""Least z component of a joint's axis by which a wheel is steered; about other axes it hangs on a rocker."""


def wheels_of(urdf: Urdf) -> list[Joint]:
    """Return the joints of wheels: joints that turn without limit, and are named like wheels or have a round link.

    The link of an unnamed wheel must hold no moving joint. Rollers on a wheel are excluded.
    """
    found: list[Joint] = []
    held = {joint.parent for joint in urdf.moving}
    for joint in urdf.joints.values():
        if joint.kind != "continuous":
            continue
        link = urdf.links.get(joint.child)
        shapes = [*link.collisions, *link.visuals] if link else []
        is_named = "wheel" in f"{joint.name} {joint.child}".lower() and not _is_swivel(urdf, joint)
        if _NO_WHEEL.search(f"{joint.name} {joint.child}"):
            continue
        is_round = joint.child not in held and any(shape.kind in ("cylinder", "sphere") for shape in shapes)
        ends_arm = sum(1 for _ in above_of(urdf, joint.parent)) >= _LEAST_ARM  # a wrist, or a tool that turns
        if is_named or (is_round and not ends_arm):
            found.append(joint)
    names = {joint.name for joint in found}
    return [joint for joint in found if not any(above.name in names for above in above_of(urdf, joint.parent))]


def is_passive(urdf: Urdf, joint: Joint) -> bool:
    """Return whether the joint belongs to a caster, which is not driven and whose position does not matter."""
    names = [f"{joint.name} {joint.child}", *(f"{above.name} {above.child}" for above in above_of(urdf, joint.parent))]
    return joint.kind == "continuous" and any(map(_CASTER.search, names))


def above_of(urdf: Urdf, link: str) -> Iterator[Joint]:
    """Yield the moving joints from a link up to the root."""
    seen = set[str]()
    while (joint := urdf.above(link)) and joint.name not in seen:
        seen.add(joint.name)
        if joint.moves:
            yield joint
        link = joint.parent


def legs_of(urdf: Urdf) -> list[Joint]:
    """Return the joints of legs; empty if there are too few for two legs."""
    found = [joint for joint in urdf.moving if _LEGS.search(joint.name) or _LEGS.search(joint.child)]
    return found if len(found) >= _LEAST_LEGS else []


def rotors_of(urdf: Urdf) -> list[Joint]:
    """Return the joints that turn rotors; their positions are usually not published."""
    return [
        joint
        for joint in urdf.moving
        if _ROTOR.search(f"{joint.name} {joint.child}") and not _GRIPPER.search(f"{joint.name} {joint.child}")
    ]


def arms_of(urdf: Urdf) -> list[list[Joint]]:
    """Return the joints of each arm: the longest chain without wheels, legs and grippers, and comparable chains.

    Joints above several arms belong to none. If a long chain branches, its branches are the fingers of a hand.
    """
    arms: list[list[Joint]] = []
    common = 0
    for chain in sorted(_chains(urdf), key=len, reverse=True):
        shares = [_shared(arm, chain) for arm in arms]
        shared = max(shares, default=0)
        if shared >= _LEAST_ARM and len(chain) > shared:
            nearest = shares.index(shared)
            arms[nearest] = arms[nearest][:shared]
        elif len(chain) - shared >= _LEAST_ARM or not arms:
            arms.append(chain)
            common = max(common, shared)
    if len(arms) == 1:
        while arms[0] and _is_lift(urdf, arms[0][0]):
            arms[0] = arms[0][1:]
    return [arm[common:] for arm in arms if len(arm) > common]


def kind_of(
    urdf: Urdf | None, driven_by: Collection[str], stacks: Collection[str], controllers: Collection[str] = ()
) -> str:
    """Name the kind of a robot, in words.

    Args:
        urdf: the description, or None.
        driven_by: the types of the topics that command it.
        stacks: the software that runs on it.
        controllers: the types of its controllers.
    """
    rotors = len(rotors_of(urdf)) if urdf else 0
    propellers = f"{rotors} propeller{'s' if rotors > 1 else ''}"
    has_wheels = bool(urdf and wheels_of(urdf))
    flies = bool(urdf and _FLYING.search(urdf.name)) or ("MAVROS" in stacks and not has_wheels)
    flies |= any("Multirotor" in kind or "MultiDOF" in kind for kind in driven_by)
    thrusters = sum(bool(_THRUSTER.search(joint.name)) for joint in urdf.joints.values()) if urdf else 0
    swims = bool(urdf and thrusters and not has_wheels and not legs_of(urdf) and not _FLYING.search(urdf.name))
    if urdf and any(_WINGS.search(joint.name) for joint in urdf.moving):
        return f"aircraft with wings, {propellers}" if rotors else "aircraft with wings"
    if (flies or rotors >= _LEAST_ROTORS) and not swims:
        base = _flying(urdf, rotors, driven_by)
    elif urdf and (joints := legs_of(urdf)):
        held = {above.name for joint in joints for above in above_of(urdf, joint.parent)}
        wheels = f" on {len(wheels_of(urdf))} wheels" if has_wheels else ""
        base = f"legged robot, {sum(joint.name not in held for joint in joints)} legs{wheels}"
    elif swims:
        base = f"vehicle on or under water, {thrusters} thruster{'s' if thrusters > 1 else ''}"
    elif rotors and not has_wheels:
        base = f"vehicle with {propellers}, on water or in the air"
    else:
        base = _base(urdf, driven_by, controllers)
    arms = [len(arm) for arm in arms_of(urdf) if len(arm) >= _LEAST_ARM] if urdf else []
    if not arms:
        return base or _mechanism(urdf)
    has_gripper = urdf and any(_GRIPPER.search(joint.name) for joint in urdf.moving)
    counts = f"{arms[0]}" if len(set(arms)) == 1 else " and ".join(map(str, arms))
    limbs = "arms" if len(arms) < _LEAST_LIMBS else "limbs (arms, legs or fingers)"
    each = f"arm of {counts} joints" if len(arms) == 1 else f"{len(arms)} {limbs} of {counts} joints"
    each += (" and a gripper" if len(arms) == 1 else " and grippers") if has_gripper else ""
    return f"{base} with {'an ' if len(arms) == 1 else ''}{each}" if base else each


def _flying(urdf: Urdf | None, rotors: int, driven_by: Collection[str]) -> str:
    """Name a drone; with a caveat if only an autopilot suggests it, which ground vehicles and boats have as well."""
    is_named = (urdf and _FLYING.search(urdf.name)) or any("Multi" in kind for kind in driven_by)
    if rotors:
        return f"drone, {rotors} rotor{'s' if rotors > 1 else ''}"
    return "drone" if is_named else "drone (or another vehicle with an autopilot)"


def _mechanism(urdf: Urdf | None) -> str:
    """Name a robot that neither drives nor has an arm: a gripper alone, a pan-tilt head, a gantry."""
    moving = urdf.moving if urdf else ()
    if moving and all(_GRIPPER.search(f"{joint.name} {joint.child}") for joint in moving):
        return "gripper"
    return f"mechanism of {len(moving)} moving joint{'s' if len(moving) > 1 else ''}" if moving else "unknown"


def _is_tracked(urdf: Urdf) -> bool:
    """Return whether it has tracks on two sides; a single or sliding track is a rail on which an arm is mounted."""
    tracks = [joint for joint in urdf.joints.values() if _TRACK.search(joint.child) and joint.kind != "prismatic"]
    return len(tracks) > 1


def _chains(urdf: Urdf) -> list[list[Joint]]:
    """Return for each leaf link the arm joints above it, from the root on."""
    no_arm = {joint.name for joint in (*wheels_of(urdf), *legs_of(urdf), *rotors_of(urdf))}
    parents = {joint.parent for joint in urdf.joints.values()}
    return [
        [joint for joint in above_of(urdf, link) if joint.name not in no_arm and _is_of_arm(joint)][::-1]
        for link in urdf.links
        if link not in parents
    ]


def _shared(one: Sequence[Joint], other: Sequence[Joint]) -> int:
    """Return the number of joints with which both chains begin."""
    count = 0
    while count < min(len(one), len(other)) and one[count].name == other[count].name:
        count += 1
    return count


def _is_of_arm(joint: Joint) -> bool:
    """Return whether the joint may belong to an arm.

    Gripper joints do not, by their own name (a wrist may hold a link named gripper), nor do planar and floating joints,
    which only describe that the robot moves about.
    """
    return not _GRIPPER.search(joint.name) and "fngr" not in joint.child and joint.kind not in ("planar", "floating")


def _is_lift(urdf: Urdf, joint: Joint) -> bool:
    """Return whether the joint lifts a torso: by its name, or because it slides and carries more than the arm."""
    if _TORSO.search(joint.name):
        return True
    body = urdf.fixed_to(joint.child)
    return joint.kind == "prismatic" and sum(urdf.fixed_to(other.parent) == body for other in urdf.moving) > 1


def _is_swivel(urdf: Urdf, joint: Joint) -> bool:
    """Return whether the joint turns about an upright axis and holds a wheel that turns about another axis."""
    body = urdf.fixed_to(joint.child)
    holds = any(other.kind == "continuous" and urdf.fixed_to(other.parent) == body for other in urdf.moving)
    return holds and _is_upright(joint)


def _holder(urdf: Urdf, wheel: Joint) -> Joint | None:
    """Return the joint on which a wheel is steered or swings; springs are skipped."""
    return next((joint for joint in above_of(urdf, wheel.parent) if joint.kind != "prismatic"), None)


def _is_upright(joint: Joint) -> bool:
    length = sum(part * part for part in joint.axis) ** 0.5
    return length > 0 and abs(joint.axis[2]) / length > _UPRIGHT


def _base(urdf: Urdf | None, driven_by: Collection[str], controllers: Collection[str]) -> str:
    """Name the mobile base; empty if there is none."""
    drives = any(kind.rpartition("/")[2].startswith("Twist") for kind in driven_by)
    is_car = any("Ackermann" in kind for kind in driven_by) or any(map(_CAR.search, controllers))
    if urdf is None:
        return "car-like base" if is_car else "base driven by velocities" if drives else ""
    wheels = wheels_of(urdf)
    if (drives or wheels) and _is_tracked(urdf):
        return "tracked base"
    holders = {joint.name: _holder(urdf, joint) for joint in wheels}
    driven = [joint for joint in wheels if not _CASTER.search(f"{joint.name} {joint.child}")]
    turned = [holder for joint in driven if (holder := holders[joint.name]) and _is_upright(holder)]
    if turned and len(turned) < len(driven):  # swivels beside driven wheels are casters that only follow
        loose = {holder.name for holder in turned if holder.kind == "continuous" and not _STEERED.search(holder.name)}
        driven = [joint for joint in driven if (holder := holders[joint.name]) is None or holder.name not in loose]
        turned = [holder for holder in turned if holder.name not in loose]
    is_car |= any(_STEERED.search(joint.name) and joint.kind == "revolute" for joint in urdf.moving) or bool(turned)
    if len(driven) >= 3 and (len(turned) == len(driven) or _is_omni(urdf, wheels, controllers)):
        return f"omnidirectional base, {len(driven)} wheels"
    if is_car:
        return f"car-like base, {len(driven)} wheels" if driven else "car-like base"
    if len(driven) == 2:
        return "differential drive base, 2 wheels"
    if len(driven) >= 4:
        doubt = "" if any(map(_NOT_SIDEWAYS.search, controllers)) else " (unless they are mecanum wheels)"
        return f"skid-steered base, {len(driven)} wheels{doubt}"
    if len(driven) == 3 or (not driven and len(wheels) >= 3):
        return f"omnidirectional base, {len(driven) or len(wheels)} wheels (by their number)"
    return "base driven by velocities" if drives else ""


def _is_omni(urdf: Urdf, wheels: Sequence[Joint], controllers: Collection[str]) -> bool:
    """Return whether its wheels are omnidirectional, by names of wheels, meshes or controllers, or by rollers."""
    if any(map(_NOT_SIDEWAYS.search, controllers)):
        return False
    links = [urdf.links[joint.child] for joint in wheels if joint.child in urdf.links]
    meshes = [shape.mesh.rpartition("/")[2] for link in links for shape in (*link.visuals, *link.collisions)]
    names = [urdf.name, *(f"{joint.name} {joint.child}" for joint in wheels), *urdf.controlled, *meshes, *controllers]
    held = {joint.child for joint in wheels}
    rollers = any(urdf.fixed_to(joint.parent) in held for joint in urdf.moving if _OMNI.search(joint.name))
    return rollers or any(map(_OMNI.search, names))
