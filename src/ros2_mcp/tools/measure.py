"""Tools that measure: conditions, health, statistics, comparisons."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ros2_mcp.ops.measure import compare as comparison
from ros2_mcp.ops.measure import health_check as health
from ros2_mcp.ops.measure import statistics
from ros2_mcp.ops.measure import wait_until as waiting
from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import Flag, Number, NumericFields, TopicName
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import Numbers
from ros2_mcp_common.wire.limits import MAX_DURATION_S, MAX_RATE_HZ

PLACE = 30

MeasuredFor = Annotated[Number, Field(ge=0.1, le=600, description="Measuring time in seconds.")]
Names = Annotated[list[str] | None, Field(max_length=100, description="Names that must exist.")]


@tool(
    title="Wait until a condition holds",
    risk="read",
    group="measure",
    recorded=True,
    program="wait_until",
    finds="wait until something happens, condition, event, threshold",
)
async def ros2_wait_until(
    report: Report,
    topic_name: TopicName,
    condition: Annotated[
        str,
        Field(
            description="On the message's fields, such as: pose.pose.position.x > 1.0 and twist.twist.linear.x == 0. "
            "With and, or, not, + - * /, comparisons, in, abs(), min(), max(), len(), hypot(), sqrt(), atan2(), "
            "yaw(pose.pose.orientation) (rad), [index] (not met where the list is shorter). For laser scans: "
            "nearest(-20, 20) < 0.6 (deg, m), range_at(90). For all elements: "
            "max(status[*].level) == 2; for the fields of one element: "
            'any(status, name == "imu" and level > 1), all().'
        ),
    ],
    timeout_s: Annotated[Number, Field(gt=0, le=MAX_DURATION_S, description="Maximum wait in seconds.")] = 30.0,
    *,
    selection: Selection,
    source: Source,
) -> waiting.Wait:
    """Wait until a message of a topic meets a condition. Every message is checked; returns the one that met it.

    Hidden topics work too, such as /navigate_to_pose/_action/status. In a recording, returns the first that met it.
    """
    lasting = source.lasting(timeout_s)
    return await waiting.wait_until(lasting, topic_name, condition, report, max_bytes=selection.max_bytes)


@tool(
    title="Health of the robot",
    risk="read",
    group="measure",
    recorded=True,
    finds="why does it not move, what is wrong, diagnose, broken, silent sensors, battery",
)
async def ros2_health_check(
    robot: Robot,
    report: Report,
    expected_topics: Names = None,
    expected_services: Names = None,
    expected_nodes: Names = None,
    check_rates: Annotated[Flag, Field(description="Also read topics; false: graph and diagnostics only.")] = True,
    rate_check_duration_sec: Annotated[Number, Field(ge=0.5, le=60, description="Listening time in seconds.")] = 3.0,
    min_expected_rate_hz: Annotated[
        Number, Field(ge=0, le=MAX_RATE_HZ, description="Minimum rate of sensors and expected topics.")
    ] = 1.0,
    *,
    source: Source,
) -> health.Health:
    """Check the whole robot: missing names, silent or slow sensors, QoS mismatches, duplicate nodes, diagnostics.

    The verdict is HEALTHY, DEGRADED or CRITICAL, with findings and recommendations.
    """
    expected = health.Expectations(
        expected_topics or (), expected_services or (), expected_nodes or (), check_rates, min_expected_rate_hz
    )
    return await health.check_health(source.lasting(rate_check_duration_sec), expected, report, robot)


@tool(
    title="Statistics of numeric fields",
    risk="read",
    group="measure",
    recorded=True,
    aliases={"duration": "duration_s"},
    program="statistics",
    beside={"ros2_topic_stats": "For sizes and ages of messages use ros2_topic_stats."},
    finds="average, minimum, maximum, noise, drift, stuck values, analyse numbers",
)
async def ros2_topic_statistics(
    report: Report,
    topic_names: Annotated[list[str], Field(min_length=1, max_length=20, description="Names of the topics.")],
    duration_s: MeasuredFor = 5.0,
    *,
    selection: Numbers,
    source: Source,
) -> statistics.Statistics:
    """Measure numeric fields of topics at the same time: min, max, mean, std, slope, gaps, jumps, stuck values, NaN.

    Also trends, and when extremes were reached.
    """
    return await statistics.measure(source.lasting(duration_s), topic_names, selection, report)


@tool(
    title="Compare two topics",
    risk="read",
    group="measure",
    recorded=True,
    program="compare",
    finds="compare two topics or sensors, difference, delay between them",
)
async def ros2_topic_compare(
    report: Report,
    topic1_name: TopicName,
    topic2_name: TopicName,
    duration_sec: MeasuredFor = 5.0,
    diff_fields: NumericFields = None,
    tolerance_percent: Annotated[
        Number, Field(ge=0, le=100, description="Tolerance in percent of a field's range (max - min).")
    ] = 0.1,
    sync_by_timestamp: Annotated[Flag, Field(description="Pair by header stamp; false: by time of receipt.")] = True,
    *,
    source: Source,
) -> comparison.Comparison:
    """Compare two topics over the same time, field by field: differences, correlation, delay.

    Quaternions are compared as rotations, angles (by name: yaw, heading, ...) modulo one turn.
    The verdict is IDENTICAL, SIMILAR, DIFFERENT or VERY DIFFERENT.
    """
    return await comparison.compare(
        source.lasting(duration_sec),
        (topic1_name, topic2_name),
        diff_fields or (),
        tolerance_percent=tolerance_percent,
        by_stamp=sync_by_timestamp,
        report=report,
    )
