"""Tools that list and read topics."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from pydantic import AliasChoices, BaseModel, ConfigDict, Field

from ros2_mcp.ops.results import Report
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.topics import list as topics
from ros2_mcp.ops.topics import stats as timing
from ros2_mcp.ops.topics import subscribe as reading
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import Duration, Hidden, Limit, MessageLimit, MessageType, Number, Pattern, TopicName
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import LimitedMessages, Messages, OneMessage
from ros2_mcp_bridge.limits import MAX_DURATION_S

PLACE = 20

MEASURE_S = 3.0
"""Enough for the rate of anything above 1 Hz, and short enough to be asked often."""


class TopicToRead(BaseModel):
    """One topic of `ros2_subscribe_multiple_topics`."""

    model_config = ConfigDict(extra="forbid")

    name: Annotated[TopicName, Field(validation_alias=AliasChoices("name", "topic_name"))]
    msg_type: Annotated[MessageType, Field(validation_alias=AliasChoices("msg_type", "message_type"))] = ""
    duration: Duration = None
    message_limit: MessageLimit = None


@tool(title="List topics", risk="read", recorded=True)
async def ros2_topic_list(
    robot: Robot, pattern: Pattern = "", include_hidden: Hidden = False, limit: Limit = 200
) -> topics.TopicList:
    """List the topics of the robot with their types and the number of publishers and subscribers."""
    return await topics.list_topics(robot, pattern, include_hidden, limit)


@tool(title="Topic details", risk="read", recorded=True)
async def ros2_topic_info(robot: Robot, topic_name: TopicName) -> topics.TopicInfo:
    """Show who publishes and subscribes on a topic, with type, type hash and QoS, and why pairs do not match."""
    return await topics.topic_info(robot, topic_name)


@tool(title="Read messages", risk="read", recorded=True, aliases={"message_type": "msg_type"})
async def ros2_topic_subscribe(
    report: Report, topic_name: TopicName, msg_type: MessageType = "", *, selection: LimitedMessages, source: Source
) -> reading.Reading:
    """Read messages of a topic: for a duration, or until a number of messages came. With neither: the first message.

    QoS is chosen to match the publishers. Camera topics come back as pictures. Long arrays are summarised: use
    fields to see a part in full. For rates use ros2_topic_stats. Of a recording: from start on, or without start the
    last seconds or messages.
    """
    return await reading.read(source, topic_name, msg_type, selection, report)


@tool(title="Read several topics", risk="read", recorded=True)
async def ros2_subscribe_multiple_topics(
    report: Report,
    topics: Annotated[list[TopicToRead], Field(min_length=1, max_length=20, description="The topics to read.")],
    selection: Messages,
    source: Source,
) -> reading.Readings:
    """Read several topics truly at the same time, each with its own duration or message limit.

    Of a recording: from start on, or without start the last seconds or messages.
    """
    wanted = [
        (topic.name, topic.msg_type, replace(selection, duration_s=topic.duration, message_limit=topic.message_limit))
        for topic in topics
    ]
    return await reading.read_several(source, wanted, report)


@tool(title="Wait for a message", risk="read", recorded=True, aliases={"msg_type": "message_type"})
async def ros2_topic_echo_wait(
    topic_name: TopicName,
    message_type: MessageType = "",
    timeout: Annotated[Number, Field(gt=0, le=MAX_DURATION_S, description="Wait at most this long, in seconds.")] = 5.0,
    *,
    selection: OneMessage,
    source: Source,
) -> reading.Echo:
    """Wait for the next message of a topic; the topic itself may appear meanwhile.

    Of a recording: the next one from start on, or without start the last one.
    """
    return await reading.echo(source.lasting(timeout), topic_name, message_type, selection)


@tool(title="Rate and age of topics", risk="read", recorded=True)
async def ros2_topic_stats(
    report: Report,
    topic_names: Annotated[list[str], Field(min_length=1, max_length=20, description="Names of the topics.")],
    duration: Annotated[
        Number | None,
        Field(gt=0, le=600, description="Measure for this long, in seconds. Default: 3; of a recording all."),
    ] = None,
    *,
    source: Source,
) -> timing.Stats:
    """Measure how topics flow, several at once: rate, jitter, gaps, bandwidth, loss, age against the header's stamp."""
    lasting = source.lasting(duration or MEASURE_S, recorded_s=duration, whole=True)
    return await timing.measure(lasting, topic_names, report)
