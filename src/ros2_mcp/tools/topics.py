"""Tools that list and read topics."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from pydantic import AliasChoices, BaseModel, ConfigDict, Field

from ros2_mcp.ops import reading, timing, topics
from ros2_mcp.ops.live import Live
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.results import Report
from ros2_mcp.ops.sources import Part, recorded_part, source_of
from ros2_mcp.ops.window import Source
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import (
    EveryN,
    Fields,
    FromBag,
    FromStart,
    Hidden,
    Limit,
    MaxArray,
    MessageType,
    Number,
    Pattern,
    TopicName,
    UpToEnd,
    Whole,
)
from ros2_mcp.tools.declare import tool

MEASURE_S = 3.0
Duration = Annotated[Number | None, Field(gt=0, le=3600, description="Collect for this long, in seconds.")]
MessageLimit = Annotated[
    Whole | None,
    Field(ge=1, le=100_000, description="Stop after this many messages (alone: waiting at most 20 s)."),
]


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
    robot: Robot,
    memory: Memory,
    report: Report,
    topic_name: TopicName,
    msg_type: MessageType = "",
    duration: Duration = None,
    message_limit: MessageLimit = None,
    fields: Fields = None,
    max_array: MaxArray = 64,
    every_n: EveryN = 1,
    bag: FromBag = "",
    start: FromStart = "",
    end: UpToEnd = "",
) -> reading.Reading:
    """Read messages of a topic: for a duration, or until a number of messages came. With neither: the first message.

    QoS is chosen to match the publishers. Camera topics come back as pictures. Long arrays are summarised: use
    fields to see a part in full. For rates use ros2_topic_stats. Of a recording: from start on, or without start the
    last seconds or messages.
    """
    request = reading.Request(topic_name, msg_type, duration, message_limit)
    source = await _source(robot, memory, request, Part(bag, start, end))
    return await reading.read(source, request, _view(robot, fields, max_array, every_n), report)


@tool(title="Read several topics", risk="read", recorded=True)
async def ros2_subscribe_multiple_topics(
    robot: Robot,
    memory: Memory,
    report: Report,
    topics: Annotated[list[TopicToRead], Field(min_length=1, max_length=20, description="The topics to read.")],
    fields: Fields = None,
    max_array: MaxArray = 64,
    every_n: EveryN = 1,
    bag: FromBag = "",
    start: FromStart = "",
    end: UpToEnd = "",
) -> reading.Readings:
    """Read several topics truly at the same time, each with its own duration or message limit.

    Of a recording: from start on, or without start the last seconds or messages.
    """
    requests = [reading.Request(t.name, t.msg_type, t.duration, t.message_limit) for t in topics]
    sources = [(await _source(robot, memory, each, Part(bag, start, end)), each) for each in requests]
    return await reading.read_several(sources, _view(robot, fields, max_array, every_n), report)


@tool(title="Wait for a message", risk="read", recorded=True, aliases={"msg_type": "message_type"})
async def ros2_topic_echo_wait(
    robot: Robot,
    memory: Memory,
    topic_name: TopicName,
    message_type: MessageType = "",
    timeout: Annotated[Number, Field(gt=0, le=3600, description="Wait at most this long, in seconds.")] = 5.0,
    fields: Fields = None,
    max_array: MaxArray = 64,
    bag: FromBag = "",
    start: FromStart = "",
    end: UpToEnd = "",
) -> reading.Echo:
    """Wait for the next message of a topic; the topic itself may appear meanwhile.

    Of a recording: the next one from start on, or without start the last one.
    """
    source = await source_of(robot, memory, Part(bag, start, end), timeout)
    return await reading.echo(source, topic_name, message_type, _view(robot, fields, max_array))


@tool(title="Rate and age of topics", risk="read", recorded=True)
async def ros2_topic_stats(
    robot: Robot,
    memory: Memory,
    report: Report,
    topic_names: Annotated[list[str], Field(min_length=1, max_length=20, description="Names of the topics.")],
    duration: Annotated[
        Number | None,
        Field(gt=0, le=600, description="Measure for this long, in seconds. Default: 3; of a recording all."),
    ] = None,
    bag: FromBag = "",
    start: FromStart = "",
    end: UpToEnd = "",
) -> timing.Stats:
    """Measure how topics flow, several at once: rate, jitter, gaps, bandwidth, loss, age against the header's stamp."""
    recorded = await recorded_part(robot, memory, Part(bag, start, end, duration))
    return await timing.measure(recorded or Live(robot, duration or MEASURE_S, whole=True), topic_names, report)


async def _source(robot: Robot, memory: Memory, request: reading.Request, part: Part) -> Source:
    return await source_of(robot, memory, replace(part, longest_s=request.duration_s), request.longest_s)


def _view(robot: Robot, fields: list[str] | None, max_array: int, every_n: int = 1) -> reading.View:
    return reading.View(fields or (), max_array, every_n, robot.result_bytes)
