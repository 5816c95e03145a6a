"""The `base.*` prompts. Each calls tools that measure in the server, so that the model does not invent numbers."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ros2_mcp.model.arguments import Argument, shown
from ros2_mcp.model.text import named
from ros2_mcp.ops.graph.known_names import is_of_every_node, live_names
from ros2_mcp.prompts.navigation import navigation_prompt
from ros2_mcp.prompts.prompt import Message, Prompt, step
from ros2_mcp.robot import Robot
from ros2_mcp_common.wire.limits import MAX_RATE_HZ, MIN_RATE_HZ

_MEASURE_S = 600.0
_LISTEN_S = 60.0
"""The longest durations that the tools accept, in s: to measure or compare topics, and to check a whole robot."""
_PATIENCE_S = 45.0
"""Some clients end a call after 60 s, whatever progress is reported; discovery and the answer take some of that."""
_MOST_TOPICS = 20
"""The most topics that are named and measured if none was chosen; with all topics of a large robot, a prompt would be
unreadable.
"""
_DISCOVERY_S = 4.0
"""For the first discovery: a bridge starts in about 2 s, and discovery takes 1 s more."""
_TRUTH = "Report only what the results say; where a value is missing, say so."


def base_prompts(robot: Robot, missing: Collection[str] = ()) -> list[Prompt]:
    """Return the five prompts that every server has; `missing` are the tools that it does not offer."""
    return [_echo_and_analyze(robot), _RELAY, _HEALTH, _COMPARE, navigation_prompt(missing)]


def _window(name: str, default: float, what: str, minimum: float = 0.1, maximum: float = _MEASURE_S) -> Argument:
    return Argument(name, f"Seconds to {what}", "number", default=default, minimum=minimum, maximum=maximum)


def _patience(duration_s: float) -> Sequence[str]:
    """Return a line about a call that may take longer than a client waits; none if it does not."""
    long = (
        f"Each call takes {shown(duration_s)} s; if the client times out earlier, use at most {shown(_PATIENCE_S)} s."
    )
    return [long] if duration_s > _PATIENCE_S else []


def _ask(*lines: str) -> Sequence[Message]:
    return [Message("\n".join(lines))]


# ── one topic, measured ────────────────────────────────────────────────────────────────────────────────────────────

_ECHO_ARGUMENTS = (
    Argument("topic_name", "Topic to analyze; empty: the only one, if there is only one", "topic", default=""),
    _window("duration_sec", 5.0, "listen"),
    Argument(
        "analysis_type",
        "What to measure",
        default="all",
        choices=("all", "statistics", "rate", "message_count"),
    ),
)
_ECHO_REPORTS = {
    "all": "the number of messages and the rate; a table of min, max, mean and standard deviation of every numeric "
    "field; then gaps and anomalies, the worst first",
    "statistics": "a table of min, max, mean and standard deviation of every numeric field, then anomalies, the worst "
    "first",
    "rate": "the rate in Hz, its regularity, and gaps",
    "message_count": "how many messages came in how many seconds",
}


def _echo_and_analyze(robot: Robot) -> Prompt:
    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        topics = [values["topic_name"]] if values["topic_name"] else await _robot_topics(robot)
        if not topics:
            return _ask(
                "Analyze a topic. No topic of a robot was found.",
                step(1, "ros2_status"),
                "Report the problems that it shows.",
            )
        if len(topics) > 1:
            return _choose_topic(topics, values["duration_sec"])
        return _analyze(topics[0], values["duration_sec"], values["analysis_type"])

    return Prompt(
        "base.ros2-topic-echo-and-analyze",
        "Analyze a topic",
        "Listen to a topic; report measured count, rate, statistics of every numeric field, gaps and anomalies.",
        _ECHO_ARGUMENTS,
        write,
    )


async def _robot_topics(robot: Robot) -> list[str]:
    return [topic for topic in await live_names(robot, "topic", _DISCOVERY_S) if not is_of_every_node(topic)]


def _analyze(topic: str, duration_s: float, analysis: str) -> Sequence[Message]:
    tools = {"all": ("ros2_topic_statistics", "ros2_topic_stats"), "statistics": ("ros2_topic_statistics",)}
    chosen = tools.get(analysis, ("ros2_topic_stats",))
    steps = [
        step(number, tool, topic_names=[topic], duration_s=duration_s) for number, tool in enumerate(chosen, start=1)
    ]
    return _ask(
        f"Analyze the topic {named(topic)} ({analysis}).",
        *steps,
        *_patience(duration_s),
        f"Then report: {_ECHO_REPORTS[analysis]}. If no message came, say so and check its publishers with "
        "ros2_topic_info.",
        _TRUTH,
    )


def _choose_topic(topics: Sequence[str], duration_s: float) -> Sequence[Message]:
    shown_topics = topics[:_MOST_TOPICS]
    more = f" (and {len(topics) - len(shown_topics)} more)" if len(topics) > len(shown_topics) else ""
    return _ask(
        f"Analyze a topic. None was named; there are {len(topics)}: {', '.join(map(named, shown_topics))}{more}.",
        step(1, "ros2_topic_stats", topic_names=shown_topics, duration_s=duration_s),
        *_patience(duration_s),
        "Then report a table of their rates, say which look unhealthy, and ask which one to analyze with "
        "ros2_topic_statistics.",
        _TRUTH,
    )


# ── relay ──────────────────────────────────────────────────────────────────────────────────────────────────────────

_RELAYED = {
    "identity": "every message",
    "rate_limit": "at most {target_rate_hz} messages per second",
    "filter": "only messages that differ from the one before",
}
_CHECK_S = 3.0
"""The time to measure a relay, in s: enough to distinguish rates of 1 Hz and more from none."""


async def _write_relay(values: Mapping[str, Any]) -> Sequence[Message]:
    source, destination, duration_s = values["source_topic"], values["destination_topic"], values["duration_sec"]
    is_limited = values["transform"] == "rate_limit"
    sooner = f"It ends by itself after {shown(duration_s)} s, or sooner" if duration_s else "It ends"
    passed = _RELAYED[values["transform"]].format(target_rate_hz=shown(values["target_rate_hz"]))
    start = step(
        1,
        "ros2_relay_start",
        source_topic=source,
        destination_topic=destination,
        message_type=values["message_type"],
        transform=values["transform"],
        target_rate_hz=values["target_rate_hz"] if is_limited else None,
        duration_sec=duration_s,
    )
    return _ask(
        f"Relay {source} to {destination}: {passed}.",
        start,
        step(2, "ros2_topic_stats", topic_names=[source, destination], duration_s=_check_s(duration_s)),
        step(3, "ros2_relay_list"),
        "Then report: both rates, how many messages were published and filtered out, and any error. "
        f"{sooner} with ros2_relay_stop; stop it only if asked to. If it is refused, say why: ros2_policy shows what "
        "is allowed.",
        _TRUTH,
    )


def _check_s(duration_s: float) -> float:
    return min(_CHECK_S, duration_s / 2) if duration_s else _CHECK_S


_RELAY = Prompt(
    "base.ros2-topic-relay",
    "Relay a topic",
    "Republish the messages of one topic on another: all, rate limited, or only changes.",
    (
        Argument("source_topic", "Topic to read", "topic", required=True),
        Argument("destination_topic", "Topic to publish on", "topic", required=True),
        Argument(
            "message_type",
            "Type, if the source has several or none yet",
            "message_type",
            default="",
            type_of="source_topic",
        ),
        Argument(
            "transform",
            "What is published; filter: only changes",
            default="identity",
            choices=("identity", "rate_limit", "filter"),
            other_choices={"on_change": "filter"},
        ),
        Argument(
            "target_rate_hz",
            "Limit for rate_limit in Hz",
            "number",
            default=10.0,
            minimum=MIN_RATE_HZ,
            maximum=MAX_RATE_HZ,
        ),
        Argument("duration_sec", "Seconds; 0: until stopped", "number", default=60.0, minimum=0, maximum=86_400),
    ),
    _write_relay,
)


# ── health ─────────────────────────────────────────────────────────────────────────────────────────────────────────


async def _write_health(values: Mapping[str, Any]) -> Sequence[Message]:
    return _ask(
        "Check the health of the robot's ROS 2 system.",
        step(1, "ros2_health_check", **values),
        *_patience(values["rate_check_duration_sec"]),
        "Then report: the verdict (HEALTHY, DEGRADED or CRITICAL) first; a table of what was checked with its state; "
        "a recommendation for each problem, the worst first.",
        _TRUTH,
    )


_HEALTH = Prompt(
    "base.ros2-node-health-check",
    "Check the robot's health",
    "Expected topics, services and rates, QoS mismatches, silent topics, diagnostics: HEALTHY, DEGRADED or CRITICAL.",
    (
        Argument("expected_topics", "Topics that must be there, such as /scan, /odom", "topics", default=[]),
        Argument("expected_services", "Services that must be there", "services", default=[]),
        Argument("check_rates", "Also measure rates", "boolean", default=True),
        _window("rate_check_duration_sec", 3.0, "measure rates", 0.5, _LISTEN_S),
        Argument(
            "min_expected_rate_hz", "A slower topic is a problem", "number", default=1.0, minimum=0, maximum=MAX_RATE_HZ
        ),
    ),
    _write_health,
)


# ── comparison ─────────────────────────────────────────────────────────────────────────────────────────────────────


async def _write_compare(values: Mapping[str, Any]) -> Sequence[Message]:
    return _ask(
        f"Compare the topics {values['topic1_name']} and {values['topic2_name']}.",
        step(1, "ros2_topic_compare", **values),
        *_patience(values["duration_sec"]),
        "Then report: the verdict (IDENTICAL, SIMILAR, DIFFERENT or VERY DIFFERENT) first; the number of pairs behind "
        "it; a table of the differences of each field; the delay between the topics; what the difference means.",
        _TRUTH,
    )


_COMPARE = Prompt(
    "base.ros2-topic-diff-monitor",
    "Compare two topics",
    "Record two topics at the same time and report field by field how far they differ.",
    (
        Argument("topic1_name", "First topic", "topic", required=True),
        Argument("topic2_name", "Second topic", "topic", required=True),
        _window("duration_sec", 5.0, "record"),
        Argument("diff_fields", "Fields to compare, such as pose.pose; empty: all numeric ones", "list", default=[]),
        Argument(
            "tolerance_percent",
            "Differences up to this count as equal",
            "number",
            default=0.1,
            minimum=0,
            maximum=100,
        ),
        Argument("sync_by_timestamp", "Pair by header stamp, not by time of arrival", "boolean", default=True),
    ),
    _write_compare,
)
