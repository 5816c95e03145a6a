"""A policy in words and numbers, for the agent that plans within it and the operator who checks it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ros2_mcp.guard.document import Document
from ros2_mcp_common.policy.checks import Checks, Zone
from ros2_mcp_common.policy.feedback import UNITS
from ros2_mcp_common.policy.keep_out import KeepOut
from ros2_mcp_common.policy.polygons import Polygon
from ros2_mcp_common.policy.rules import Allowance, Forbidden, Limit, RuleSet, Ruling
from ros2_mcp_common.policy.trajectory_limits import CurveLimits, JointBounds

_ACTS = {
    "publish": "Publish {types} on {names}",
    "relay": "Relay {types} to {names}",
    "play": "Play recorded {types} on {names}",
    "call": "Call {names} ({types})",
    "goal": "Send goals to {names} ({types})",
    "cancel": "Cancel any client's goals of {names}",
    "set": "Set parameters of {names}",
    "transition": "Change the lifecycle state of {names}",
    "record": "Record {names}",
    "read": "Ask {names} ({types})",
}
_EVERYTHING = ("**", "/**")
_APPROVAL = "a person approves each"


def allowed(rules: RuleSet) -> list[str]:
    """Return the allowances of a policy, one sentence for each rule."""
    if rules.allows_all:
        return ["Everything that is not forbidden."]
    return [_allowance(entry) for entry in rules.allow]


def limits(rules: RuleSet) -> list[str]:
    """Return the limits on the values of types, one sentence each, and the zones with their corners."""
    return [*map(_limit, rules.limits), *(_zone(name, zone) for name, zone in rules.zones.items())]


def forbidden(rules: RuleSet) -> list[str]:
    """Return what a policy forbids, one sentence for each rule."""
    return [_forbidden(entry) for entry in rules.forbid]


def bounds(ruling: Ruling) -> str:
    """Return a sentence with the bounds on an allowed command, from the rules and limits that apply to it."""
    clauses = [clause for entry in ruling.allowances for clause in _bounds_of(entry) if clause != _APPROVAL]
    clauses += [clause for entry in ruling.limits for clause in _bounds_of_limit(entry)]
    return f"The policy bounds {'; '.join(dict.fromkeys(clauses)) or 'nothing of it'}."


def watched(document: Document, most: Mapping[str, float]) -> list[str]:
    """Return sentences about the watchdog's reasons to stop the robot and set the latch. `most` are the limits on
    velocities (m/s, rad/s), by part.
    """
    told: list[str] = []
    stopped = "It is stopped, and the latch set, when"
    if feedback := document.feedback:
        whens = [f"it still moves {feedback.within_s:g} s after its zero (more than {_speeds(feedback.still)})"]
        if most:
            whens.append(f"a velocity drives it faster than {_speeds(most, feedback.over)}")
        if feedback.goals:
            whens.append(f"a goal drives it faster than {_speeds(feedback.goals, feedback.over)}")
        whens.append(f"it is driven for {feedback.max_age_s:g} s without having told it")
        kinds = [kind for kind, known in (("a velocity", most), ("a goal", feedback.goals)) if not known]
        unjudged = f" How fast {_one_of(kinds)} drives it is not judged." if kinds else ""
        told.append(f"{feedback.topic} tells the robot's speed. {stopped} {_one_of(whens)}.{unjudged}")
    if pose := document.pose:
        whens = [f"it is driven for {pose.max_age_s:g} s without having told it"]
        if pose.zone:
            whens.insert(0, f"it would leave the zone {pose.zone} though it braked with {pose.brake_mps2:g} m/s²")
        way_back = " Once it is outside, no motion brings it back: the operator does." if pose.zone else ""
        told.append(
            f"{pose.topic} tells the robot's place in the frame {pose.frame_id}. {stopped} {_one_of(whens)}.{way_back}"
        )
    if keep_out := document.keep_out:
        told += _keep_out(keep_out)
    return told


def _keep_out(keep_out: KeepOut) -> Iterable[str]:
    """Yield sentences about the keep-out zones: each with its corners, and what happens before a zone."""
    for name, corners in keep_out.zones.items():
        yield f"The keep-out zone {name} in the frame {keep_out.frame_id} has the corners {_corners(corners)} m."
    round_m = f"a circle of {keep_out.radius_m:g} m"
    outline = f"the polygon {_corners(keep_out.footprint)} m" if keep_out.footprint else round_m
    yield (
        f"The robot's outline, {outline}, keeps {keep_out.margin_m:g} m from keep-out zones: goals and planned paths "
        f"that lead nearer are refused, and a drive is ended when the path on {keep_out.plan} does, or before it "
        f"comes nearer than {keep_out.watched_m:g} m. From there only velocities that lead away may drive it; nearer "
        f"than {keep_out.latched_m:g} m the latch is set, and the operator drives it out."
    )


def _corners(polygon: Polygon) -> str:
    return ", ".join(f"({x:g}, {y:g})" for x, y in polygon)


def _speeds(parts: Mapping[str, float], over: float = 1.0) -> str:
    return _one_of([f"{speed * over:g} {UNITS[part]}" for part, speed in parts.items()])


def _allowance(entry: Allowance) -> str:
    act = _ACTS[entry.verb].format(names=_names(entry.names), types=_types(entry.types))
    return f"{act}{_behind(_bounds_of(entry))}."


def _bounds_of(entry: Allowance) -> Iterable[str]:
    if entry.rate_hz is not None:
        yield f"at most {entry.rate_hz:g} Hz"
    if entry.for_s is not None:
        yield f"for at most {entry.for_s:g} s each time"
    if entry.per_minute is not None:
        yield f"at most {entry.per_minute:g} times a minute"
    if entry.sole_publisher:
        yield "only where no node of the robot publishes"
    if entry.sources:
        yield f"from {_names(entry.sources)}"
    for these in (entry.parameters, entry.transitions):
        if these and not set(these) & set(_EVERYTHING):
            yield f"only {', '.join(these)}"
    if entry.force:
        yield "also where others publish"
    if entry.meta or (entry.verb == "call" and any("*" in kind for kind in entry.types)):
        yield f"{'also' if entry.meta else 'not'} what changes the robot's set-up"
    yield from in_words(entry.checks, entry.types)
    if entry.consent:
        yield _APPROVAL if entry.consent == "each" else "no approval is needed"


def _limit(entry: Limit) -> str:
    where = "" if set(entry.names) <= set(_EVERYTHING) else f" on {_names(entry.names)}"
    return f"{_types(entry.types)}{where}{_behind(_bounds_of_limit(entry))}."


def _bounds_of_limit(entry: Limit) -> Iterable[str]:
    yield from in_words(entry.checks, entry.types)
    for path, ramp in entry.ramp.items():
        ways = ((ramp.up, "grows"), (ramp.down, "shrinks"))
        yield from (f"{path} {way} by at most {most:g} per second" for most, way in ways if most is not None)
    if entry.hold_s is not None:
        yield f"the zero follows {entry.hold_s:g} s after the last command"
    if entry.tool == "clamp":
        yield "what is beyond is scaled down"
    if entry.stream == "refuse":
        yield "what is beyond is held back in relays and playbacks, too"


def in_words(checks: Checks, types: Sequence[str] = ()) -> Iterable[str]:
    """Yield the checks on a value of these types, one clause each. Angular velocities are also given in °/s, the unit
    of `ros2_drive`.
    """
    are_velocities = bool(types) and all("/Twist" in kind for kind in types)
    for path, most in checks.norm.items():
        yield f"the length of {path} at most {_with_unit(path, most) if are_velocities else f'{most:g}'}"
    for path, (low, high) in checks.range.items():
        yield f"{path} from {low:g} to {_with_unit(path, high) if are_velocities else f'{high:g}'}"
    for path, choices in checks.one_of.items():
        yield f"{path} {_one_of([*map(_text, choices)])}"
    if checks.zero:
        yield f"{', '.join(checks.zero)} 0"
    for path, (fewest, most) in checks.count.items():
        yield f"{path} with {fewest} to {most} elements" if most else f"{path} empty"
    for path, zone in checks.zone.items():
        yield f"{path or 'the position'} in the zone {zone}"
    for path, pace in checks.pace.items():
        yield f"{path} at most {pace.most:g} per second between points, the first not before {pace.first_s:g} s"
    for path, curve in checks.curve.items():
        yield f"all along the curve of {path or 'the trajectory'}, {'; '.join(_curve(curve))}"
    if checks.keep_out:
        yield f"outside of the keep-out zones {', '.join(checks.keep_out.zones)}, with the robot's whole outline"


def _with_unit(path: str, speed: float) -> str:
    """Return the largest speed of a part of a Twist, with its unit."""
    is_angular = "angular" in path.split(".")
    return f"{speed:g} rad/s ({math.degrees(speed):.0f} °/s)" if is_angular else f"{speed:g} m/s"


def _curve(limits: CurveLimits) -> Iterable[str]:
    """Yield the limits on a trajectory, for each joint."""
    everywhere = JointBounds(*(limits.position or (None, None)), limits.speed, limits.acceleration)
    yield from filter(None, [_joint("each joint", everywhere)])
    if limits.step is not None:
        yield f"its speed jumps by at most {limits.step:g} at a point"
    elif limits.acceleration is not None or any(each.acceleration is not None for each in limits.joints.values()):
        yield "its speed does not jump"
    yield from (_joint(name, bounds) for name, bounds in limits.joints.items())
    if limits.joints:
        yield "no other joint"
    if limits.described:
        yield "each within the limits of the robot's description"


def _joint(name: str, bounds: JointBounds) -> str:
    parts = (
        f"from {bounds.low:g} to {bounds.high:g}" if bounds.low is not None and bounds.high is not None else "",
        f"at most {bounds.speed:g} per second" if bounds.speed is not None else "",
        f"accelerated by at most {bounds.acceleration:g}" if bounds.acceleration is not None else "",
    )
    told = " and ".join(filter(None, parts))
    return f"{name} {told}" if told else name if name != "each joint" else ""


def _forbidden(entry: Forbidden) -> str:
    act = _ACTS[entry.verb].partition(" ")[0] if entry.verb else "Everything"
    return f"{act} on {_names(entry.names)} with {_types(entry.types)}."


def _zone(name: str, zone: Zone) -> str:
    margin = f", {zone.margin_m:g} m from its edges" if zone.margin_m else ""
    return f"The zone {name} in the frame {zone.frame_id} has the corners {_corners(zone.polygon)} m{margin}."


def _names(patterns: Sequence[str]) -> str:
    return _one_of([*map(_name, patterns)])


def _name(pattern: str) -> str:
    if pattern in _EVERYTHING:
        return "any name"
    rest = pattern.removeprefix("/**/")
    return f"{rest} in any namespace" if rest != pattern and "*" not in rest else pattern


def _types(patterns: Sequence[str]) -> str:
    return _one_of(["any type" if pattern in _EVERYTHING else pattern for pattern in patterns])


def _one_of(words: Sequence[str]) -> str:
    """Return the words as `a, b or c`."""
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _text(value: Any) -> str:
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else ascii(value)


def _behind(clauses: Iterable[str]) -> str:
    text = "; ".join(clauses)
    return f": {text}" if text else ""
