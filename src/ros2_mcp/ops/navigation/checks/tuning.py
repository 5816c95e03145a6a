"""Parameters that abort goals: time-outs that are too short, a rate that is missed, progress that cannot be made."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.checks.check import TUNING, NavCheck
from ros2_mcp.ops.navigation.evidence import (
    VELOCITIES,
    Heard,
    NavEvidence,
    NavFinding,
    is_of_role,
    is_zero,
    line_age_s,
    said,
    speed_of,
)

_ACKNOWLEDGE = r"timed out while waiting for action server to acknowledge"
_SHORT_MS = 20.0
"""Nav2's default, which is short on a loaded computer; less leaves a planner no time to answer."""
_LEAST_SERVERS, _TIMES_SLOWER, _SLOW_S = 4, 5.0, 0.05
"""On a loaded computer all servers are slow; a server five times as slow as the median has a problem of its own."""
_RECENT_S = 300.0
MISSED = 0.6
"""A controller whose measured rate is below this share of the rate that is set misses it."""
_LEAST = 8
_FASTEST = ("max_vel_x", "max_speed_xy", "desired_linear_vel", "vx_max", "max_linear_speed")
_TURNS = ("max_vel_theta", "wz_max", "rotate_to_heading_angular_vel")


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    yield from _acknowledged(evidence)
    yield from _rate(evidence)
    yield from _progress(evidence)


def _acknowledged(evidence: NavEvidence) -> Iterator[NavFinding]:
    slow = _slow(evidence)
    lines = [line for line in evidence.lines(_ACKNOWLEDGE) if (line_age_s(evidence, line) or 0.0) < _RECENT_S]
    for node in evidence.of_role("bt_navigator"):
        timeout_ms = evidence.value(node, "default_server_timeout")
        is_short = isinstance(timeout_ms, (int, float)) and not isinstance(timeout_ms, bool) and timeout_ms < _SHORT_MS
        is_slower = isinstance(timeout_ms, (int, float)) and bool(slow) and slow[1] * 1000 > 2 * float(timeout_ms)
        if not (lines or is_short or is_slower):
            continue
        told = f"default_server_timeout is {timeout_ms:g} ms." if isinstance(timeout_ms, (int, float)) else ""
        heard = f"{said(lines[-1])}, {len(lines)} times." if lines else ""
        if slow and is_slower:
            heard += f" {named(slow[0])} takes {slow[1] * 1000:.0f} ms to answer a question, the others less."
        yield NavFinding(
            rank="stops some goals" if lines or is_slower else "makes it worse",
            subject=node,
            cause=f"{named(node)} gives up before the servers can answer.",
            proof=" ".join(filter(None, (heard, told))),
            remedy="Raise default_server_timeout of bt_navigator (such as 200 ms) and wait_for_service_timeout.",
        )


def _slow(evidence: NavEvidence) -> tuple[str, float] | None:
    """Return a planner or controller server that answers much more slowly than the others, and its shorter answer time
    of two, in s."""
    times: Mapping[str, float] = getattr(evidence.states, "answered_s", {})
    if len(times) < _LEAST_SERVERS:
        return None
    usual_s = sorted(times.values())[len(times) // 2]
    node = max(evidence.of_role("planner_server", "controller_server"), key=lambda one: times.get(one, 0.0), default="")
    slowest_s = times.get(node, 0.0)
    return (node, slowest_s) if slowest_s > max(_TIMES_SLOWER * usual_s, _SLOW_S) else None


def _rate(evidence: NavEvidence) -> Iterator[NavFinding]:
    """Find a controller that misses its rate, measured while it drives: Nav2's own warning about it is often false."""
    for node in evidence.of_role("controller_server"):
        wanted_hz = evidence.value(node, "controller_frequency")
        if not isinstance(wanted_hz, (int, float)):
            continue
        for one in evidence.of(*VELOCITIES):
            times = _sent_by(node, one)
            if len(times) < _LEAST:
                continue
            rate_hz = (len(times) - 1) / max((times[-1] - times[0]) / 1e9, 1e-3)
            if rate_hz < MISSED * float(wanted_hz):
                yield NavFinding(
                    rank="makes it worse",
                    subject=node,
                    cause=f"{named(node)} misses its rate.",
                    proof=f"{rate_hz:.1f} of {float(wanted_hz):g} Hz on {named(one.topic)}.",
                    remedy="Lower controller_frequency, or give the controller fewer samples or a smaller costmap.",
                )


def _sent_by(controller: str, one: Heard) -> list[int]:
    """Return the times of receipt (ns) of the commands that a controller sent; none if they may be another's.

    Nav2's behaviours publish on the controller's topic, each with a publisher that is silent until it runs, and at
    another rate. A behaviour either turns or drives straight: a publisher that does both at once is the controller's.
    """
    others = [node for node in one.nodes if node != controller]
    if controller not in one.nodes or not all(is_of_role(node, "behavior_server") for node in others):
        return []
    by_writer: dict[int, list[tuple[int, Any]]] = {}
    for received_ns, message, writer in one.messages:
        if not is_zero(message):
            by_writer.setdefault(writer, []).append((received_ns, message))
    sent = [
        [received_ns for received_ns, _ in rows]
        for rows in by_writer.values()
        if not others or any(_steers(message) for _, message in rows)
    ]
    return max(sent, key=len) if sent else []


def _steers(command: Any) -> bool:
    ahead, left, turn = speed_of(command)
    return bool((ahead or left) and turn)


def _progress(evidence: NavEvidence) -> Iterator[NavFinding]:
    """Find progress checkers that ask for more distance than the robot can drive in the allowed time."""
    for node in evidence.of_role("controller_server"):
        values: Mapping[str, Any] = (evidence.parameters or {}).get(node, {})
        fastest = [
            (float(value), f"{name} of {named(node)}")
            for name, value in values.items()
            if name.rpartition(".")[2] in _FASTEST and isinstance(value, (int, float)) and value > 0
        ]
        for smoother in evidence.of_role("velocity_smoother"):
            limits = evidence.value(smoother, "max_velocity")
            if isinstance(limits, (list, tuple)) and limits and float(limits[0]) > 0:  # type: ignore[arg-type]
                fastest.append((float(limits[0]), f"max_velocity of {named(smoother)}"))  # type: ignore[arg-type]
        for name, radius in values.items():
            checker, _, last = name.rpartition(".")
            if last != "required_movement_radius" or not isinstance(radius, (int, float)):
                continue
            allowed = values.get(f"{checker}.movement_time_allowance")
            if not isinstance(allowed, (int, float)) or not allowed or not fastest:
                continue
            asked = float(radius) / float(allowed)
            speed, where = min(fastest)
            if asked >= speed:
                yield NavFinding(
                    rank="stops some goals",
                    subject=node,
                    cause="The progress checker asks for more than the robot may drive: goals end with no progress.",
                    proof=f"{float(radius):g} m in {float(allowed):g} s is asked ({asked:.2f} m/s), "
                    f"{speed:g} m/s is allowed ({where}).",
                    remedy=f"Raise {checker}.movement_time_allowance of {named(node)} to "
                    f"{3 * float(radius) / speed:.0f} s; or raise that speed, or lower {name.rpartition('.')[2]}.",
                )
            elif time_s := _turning_s(values, f"{checker}.plugin", float(allowed)):
                yield NavFinding(
                    rank="stops some goals",
                    subject=node,
                    cause="The progress checker gives up while the robot turns on the spot.",
                    proof=f"Half a turn takes {time_s:.1f} s at least; {float(allowed):g} s are allowed.",
                    remedy="Use PoseProgressChecker, which counts turning, or raise movement_time_allowance.",
                )


def _turning_s(values: Mapping[str, Any], plugin: str, allowed_s: float) -> float:
    """Return the time of half a turn, in s, if it is longer than allowed and turning does not count as progress; else
    0."""
    if "Pose" in str(values.get(plugin, "")):
        return 0.0
    fastest = [
        float(value)
        for name, value in values.items()
        if name.rpartition(".")[2] in _TURNS and isinstance(value, (int, float)) and value > 0
    ]
    time_s = math.pi / max(fastest) if fastest else 0.0
    return time_s if time_s > allowed_s else 0.0


CHECK = NavCheck(("parameters",), _find, TUNING)
