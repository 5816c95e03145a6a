"""Read the keep-out zones of a policy (`keep_out` in `docs/reference/policy-file.md`), and compile them into limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ros2_mcp.guard.section import Section
from ros2_mcp_common.policy.checks import Checks
from ros2_mcp_common.policy.keep_out import GOAL_TOPICS, GOALS, MOST_ZONES, POSE_STAMPED, KeepOut
from ros2_mcp_common.policy.polygons import Polygon, what_is_wrong
from ros2_mcp_common.policy.rules import Limit

_MARGIN_M = 0.2
_PLAN = "/plan"


def keep_out_of(section: Section | None, policy: str) -> KeepOut | None:
    """Return the keep-out zones of a policy; None without the key. Raises `PolicyFileError`."""
    if section is None:
        return None
    section.require("zones")
    zones = section.section("zones", "the zones of keep_out")
    polygons = {name: polygon(zones, name) for name in zones.all()} if zones else {}
    if len(polygons) > MOST_ZONES:
        raise section.error_at("zones", f"{len(polygons)} zones are more than the {MOST_ZONES} that can be judged.")
    if section.has("footprint") == section.has("radius_m"):
        problem = "keep_out needs the outline of the robot: either 'footprint' or 'radius_m'."
        hint = "Nav2 has it as footprint or robot_radius, of its costmaps: footprint: [[0.3, 0.2], [0.3, -0.2], …]."
        raise section.error(section.node, problem, hint)
    plan = section.text("plan", _PLAN)
    if not plan.startswith("/") or "*" in plan:
        raise section.error_at("plan", f"{plan!r} is not the full name of a topic.", "Such as /plan.")
    found = KeepOut(
        rule=f"{policy} line {section.line}: keep_out",
        frame_id=section.text("frame", "map"),
        zones=polygons,
        margin_m=section.needed_number("margin_m", _MARGIN_M, low=0.05, high=10.0),
        radius_m=section.needed_number("radius_m", 0.0, low=0.01, high=100.0),
        footprint=polygon(section, "footprint") if section.has("footprint") else (),
        plan=plan,
    )
    section.done()
    return found


def polygon(section: Section, key: str) -> Polygon:
    """Return the corners of a polygon, which encloses an area once. Raises `PolicyFileError`."""
    corners = section.points(key)
    if problem := what_is_wrong(corners):
        hint = "Three corners or more, one after the other around it: [[0, 0], [4, 0], [4, 2]]."
        raise section.error_at(key, f"{key} is not a valid polygon: {problem}.", hint)
    return corners


def limits_of(keep_out: KeepOut | None) -> Sequence[Limit]:
    """Return the limits that keep goals out of the zones, whatever allows the goals."""
    if keep_out is None:
        return ()
    checks = Checks(keep_out=replace(keep_out, rule=""))
    return (
        Limit(keep_out.rule, types=GOALS, checks=checks),
        Limit(keep_out.rule, types=(POSE_STAMPED,), names=GOAL_TOPICS, checks=checks, stream="refuse"),
    )
