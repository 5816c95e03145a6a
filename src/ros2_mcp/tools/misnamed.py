"""Finds the argument that a wrong name means: models use the names of other tools and systems.

Names with the same meaning are accepted, which the answer reports; other names only get a hint in the error.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from ros2_mcp.model.names import did_you_mean

_TIMES_OUT = ("timeout_s", "timeout_sec", "timeout", "wait_s")
_DURATIONS = ("duration_s", "duration", "duration_sec", "rate_check_duration_sec", "max_duration_s", *_TIMES_OUT)
_LIMITS = ("message_limit", "max_messages", "number_of_messages", "limit")
_RATES = ("frequency", "target_rate_hz", "rate", "min_expected_rate_hz")
_TYPES = ("message_type", "msg_type", "service_type", "action_type")
_TOPICS = ("topic_name", "topic_names", "topics", "source_topic", "expected_topics", "series")
_VALUES = ("data", "fields", "goal_fields", "values")

MEANT: Mapping[str, Sequence[str]] = {
    **dict.fromkeys(("topic_type", "msg_type", "message_type", "type", "interface", "interface_type"), _TYPES),
    **dict.fromkeys(("topic", "topics", "topic_name", "topic_names"), _TOPICS),
    **dict.fromkeys(
        ("node", "nodes", "node_name", "node_names"), ("node_name", "node_names", "node", "expected_nodes")
    ),
    **dict.fromkeys(("service", "srv", "srv_name"), ("service_name", "expected_services")),
    "srv_type": ("service_type",),
    "action": ("action_name",),
    **dict.fromkeys(("goal", "goal_msg"), ("goal_fields", "goal_id_hex")),
    **dict.fromkeys(("goal_id", "id"), ("goal_id_hex", "recording_id", "relay_id", "playback_id")),
    **dict.fromkeys(("request", "args", "arguments", "params", "message", "msg", "payload", "value"), _VALUES),
    **dict.fromkeys(("parameters", "parameter"), ("values", "names")),
    **dict.fromkeys(("rate", "rate_hz", "hz", "freq", "frequency_hz"), _RATES),
    **dict.fromkeys(("timeout", "timeout_s", "timeout_sec", "wait"), _TIMES_OUT),
    **dict.fromkeys(("duration", "duration_s", "duration_sec", "seconds", "time"), _DURATIONS),
    **dict.fromkeys(("count", "n", "num_messages", "max_messages", "limit", "message_count"), _LIMITS),
    **dict.fromkeys(("filter", "search", "query"), ("pattern", "condition")),
    **dict.fromkeys(("expression", "predicate"), ("condition",)),
    **dict.fromkeys(("start_time", "from", "since"), ("start", "time_start", "since")),
    **dict.fromkeys(("end_time", "to", "until"), ("end", "time_end")),
}
"""Wrong name → the arguments it may mean; the hint names the first argument that the tool has."""


_SAME: Sequence[Sequence[str]] = (
    ("duration", "duration_s", "duration_sec"),
    ("timeout", "timeout_s", "timeout_sec", "wait_timeout_sec"),
    ("wait", "wait_s", "wait_sec"),
    ("message_limit", "max_messages", "number_of_messages"),
    ("node", "nodes", "node_name", "node_names"),
    ("topic", "topic_name", "topics", "topic_names"),
    ("service", "service_name"),
    ("action", "action_name"),
    ("type", "msg_type", "message_type", "topic_type"),
    ("recording_id", "recording", "bag", "bag_name"),
    ("playback_id", "playback"),
    ("relay_id", "relay"),
)
"""Names with the same meaning, accepted if the tool has exactly one of them."""
_SAME_FOR_READING: Sequence[Sequence[str]] = ((*_SAME[0], *_SAME[1]),)
"""More such names for tools that only read: there, duration and time-out both limit the call."""


def taken_for(name: str, known: Collection[str], *, acts: bool) -> str:
    """Return the argument of a tool that another name means; the name itself if that is not certain.

    Args:
        name: as it was given.
        known: the arguments of the tool.
        acts: whether the tool can change or move something.
    """
    if name in known:
        return name
    for same in (*_SAME, *(() if acts else _SAME_FOR_READING)):
        meant = [one for one in same if one in known]
        if name.lower() in same and len(meant) == 1:
            return meant[0]
    return name


def hint_for(name: str, known: Sequence[str]) -> str:
    """Return a hint with the argument that was probably meant, or else with all arguments."""
    meant = next((one for one in MEANT.get(name.lower(), ()) if one in known), "")
    return f"Did you mean {meant}?" if meant else did_you_mean(name, known, f"It takes: {', '.join(known) or 'none'}.")
