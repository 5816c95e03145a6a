"""A computer with too much to do: all answers and all messages are late at once, so that no single delay says anything
about its node.
"""

from __future__ import annotations

from dataclasses import replace

from ros2_mcp.model.text import counted, named
from ros2_mcp.ops.navigation.evidence import ODOMETRY, SCAN, Frames, Heard, NavEvidence, NavFinding, States

SUBJECT = "load"
_LEAST_SERVERS, _NEARLY_ALL, _MANY = 3, 0.7, 0.5
_LOW_HZ = {SCAN: 4.0, ODOMETRY: 8.0}
"""The slowest lasers turn five times a second, and odometry comes ten times a second or more."""
_LEAST_SERIES = 2
_LATE_S = 0.25
"""A node that spins answers within milliseconds."""
_ANSWER_S = 1.2
_STALE_NS = 6_000_000_000
"""What was not told for so long is not only late."""
_MOST_NAMES = 4


def busy_in(evidence: NavEvidence) -> NavFinding | None:
    """Find an overloaded computer: nearly no service answers, or all topics are slow and services answer late. One
    finding covers all of it.
    """
    states = evidence.states or {}
    silent = [node for node, state in states.items() if not state]
    series = [one for one in evidence.of(*_LOW_HZ) if one.nodes]
    low = [one for one in series if one.rate_hz < _LOW_HZ[one.type]]
    # One process with all servers may hang by itself: then what others publish comes as ever.
    is_silent = len(states) >= _LEAST_SERVERS and len(silent) >= _NEARLY_ALL * len(states) and low == series
    is_slow = len(low) == len(series) >= _LEAST_SERIES and any(one.count for one in low)
    is_slow = is_slow and {one.type for one in series} == set(_LOW_HZ)
    if not is_silent and not (is_slow and _is_late(evidence)):
        return None
    rates = ", ".join(f"{named(one.topic)} ({one.rate_hz:.2g} Hz)" for one in low[:_MOST_NAMES])
    proof = [f"{len(silent)} of {counted(len(states), 'service')} did not answer within {_ANSWER_S:g} s."]
    if low:
        proof.append(f"The rates of {rates} are {'all ' if len(low) == len(series) > 1 else ''}low.")
    if times := sorted(getattr(states, "answered_s", {}).values()):
        proof.append(f"Of those that answered, half took {times[len(times) // 2]:.2f} s and more.")
    return NavFinding(
        rank="makes it worse",
        subject=SUBJECT,
        cause="The robot's computer, or this server, is too busy: answers and messages are late everywhere.",
        proof=" ".join(proof),
        remedy="See what loads the computers (top), end what is not needed, and ask again.",
    )


def without_what_is_late(evidence: NavEvidence) -> NavEvidence:
    """Return the evidence without what an overloaded computer may explain: missing answers, silent topics, late
    transforms.
    """
    states = evidence.states
    if states is not None:
        states = States({node: state for node, state in states.items() if state}, getattr(states, "answered_s", {}))
    heard = evidence.heard
    if heard is not None:
        heard = {topic: one for topic, one in heard.items() if not _may_be_late(one)}
    frames: Frames | None = evidence.frames and replace(evidence.frames, stale_ns=_STALE_NS)
    return replace(evidence, states=states, heard=heard, frames=frames)


def _may_be_late(one: Heard) -> bool:
    return one.is_silent and not one.kept


def _is_late(evidence: NavEvidence) -> bool:
    """Whether the services are late: many did not answer in time, or half of the services that answered took long."""
    states = evidence.states or {}
    times = sorted(getattr(states, "answered_s", {}).values())
    if len(times) >= _LEAST_SERVERS and times[len(times) // 2] > _LATE_S:
        return True
    if states and sum(not state for state in states.values()) >= _MANY * len(states):
        return True
    asked = [node for node in evidence.robots_nodes if f"{node}/get_parameters" in (evidence.graph.services or {})]
    answered = [node for node in asked if (evidence.parameters or {}).get(node)]
    return len(asked) >= _LEAST_SERVERS and len(answered) <= _MANY * len(asked)
