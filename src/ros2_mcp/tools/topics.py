"""Tools that list, read, measure and publish topics."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from pydantic import AliasChoices, BaseModel, ConfigDict, Field

from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.topics import info, publish, stats, subscribe
from ros2_mcp.ops.topics.list import TopicList, list_topics
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import (
    Duration,
    Flag,
    Hidden,
    Limit,
    MessageLimit,
    MessageType,
    Number,
    Pattern,
    TopicName,
)
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import LimitedMessages, Messages, OneMessage
from ros2_mcp_common.wire.limits import MAX_DURATION_S, MAX_RATE_HZ, MIN_RATE_HZ

PLACE = 20
_PUBLISHING_PLACE = 60
"""After all tools that only read, just before `ros2_stop`."""

MAX_MEASURE_S = 600
"""The time and the size of every message are stored: at 1 kHz 600,000 for each topic in ten minutes."""
MEASURE_S = 3.0
"""Enough for the rate of any topic above 1 Hz, and short enough to be called often."""

Data = Annotated[
    dict[str, Any],
    Field(
        description='Message fields, such as {"linear": {"x": 0.2}}; other fields get defaults. Numbers also "nan", '
        '"inf", "-inf".'
    ),
]
_SEVERAL = Field(min_length=1, max_length=20)  # more than a person reads or commands at once
_HZ = "Messages per second; needs `duration`."
_SECONDS = "Duration in seconds; needs frequency."
Destination = Annotated[str, Field(description="Such as /cmd_vel.")]
PublishedType = Annotated[str, Field(description="Such as geometry_msgs/msg/Twist. Default: the topic's own.")]


class TopicToRead(BaseModel):
    """One topic of `ros2_subscribe_multiple_topics`."""

    model_config = ConfigDict(extra="forbid")

    name: Annotated[TopicName, Field(validation_alias=AliasChoices("name", "topic_name"))]
    msg_type: Annotated[MessageType, Field(validation_alias=AliasChoices("msg_type", "message_type"))] = ""
    duration: Duration = None
    message_limit: MessageLimit = None
    fields: Annotated[list[str] | None, Field(description="Fields of this topic, instead of those for all.")] = None


class TopicToPublish(BaseModel):
    """One topic of `ros2_publish_multiple_topics`."""

    model_config = ConfigDict(extra="forbid")

    topic_name: Destination
    message_type: Annotated[PublishedType, Field(validation_alias=AliasChoices("message_type", "msg_type"))] = ""
    data: Data
    frequency: Annotated[Number, Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ, description=_HZ)] = 1.0
    duration: Annotated[Number, Field(gt=0, le=MAX_DURATION_S, description=_SECONDS)] = 5.0


@tool(
    title="List topics",
    risk="read",
    recorded=True,
    program="topics",
    finds="which topics are there, list topics, which sensors",
)
async def ros2_topic_list(
    robot: Robot,
    pattern: Pattern = "",
    include_hidden: Hidden = False,
    limit: Limit = 200,
    request_fields: Annotated[Flag, Field(description="Also list the fields of each topic's messages.")] = False,
) -> TopicList:
    """List the topics of the robot with their types and the number of publishers and subscribers."""
    return await list_topics(robot, pattern, include_hidden, limit, with_fields=request_fields)


@tool(
    title="Topic details",
    risk="read",
    recorded=True,
    finds="who publishes, who subscribes, QoS, why does nothing arrive on a topic",
)
async def ros2_topic_info(robot: Robot, topic_name: TopicName) -> info.TopicInfo:
    """Show who publishes and subscribes on a topic, with type, type hash and QoS, and why pairs do not match."""
    return await info.topic_info(robot, topic_name)


@tool(
    title="Read messages",
    risk="read",
    recorded=True,
    aliases={"message_type": "msg_type"},
    beside={"ros2_topic_stats": "For rates use ros2_topic_stats."},
    finds="camera picture image photo, laser scan obstacle, odometry, battery level, sensor values, echo topic",
)
async def ros2_topic_subscribe(
    report: Report, topic_name: TopicName, msg_type: MessageType = "", *, selection: LimitedMessages, source: Source
) -> subscribe.Reading:
    """Read messages of a topic: for a duration, or until a number of messages came. With neither, the first message.

    QoS is chosen to match the publishers. Images and maps come as pictures.
    Long arrays are summarised: use fields to see a part in full. From a recording: messages from
    start on, or without start the last seconds or messages.
    """
    return await subscribe.read(source, topic_name, msg_type, selection, report)


@tool(title="Read several topics", risk="read", recorded=True, finds="read several topics or sensors together")
async def ros2_subscribe_multiple_topics(
    report: Report,
    topics: Annotated[list[TopicToRead], _SEVERAL, Field(description="The topics to read.")],
    selection: Messages,
    source: Source,
) -> subscribe.Readings:
    """Read several topics truly at the same time, each with its own duration or message limit.

    Images and maps come as pictures. From a recording: messages from start on, or without start the
    last seconds or messages.
    """
    requests = [
        (
            topic.name,
            topic.msg_type,
            replace(
                selection,
                fields=topic.fields or selection.fields,
                shared=not topic.fields,
                duration_s=topic.duration,
                message_limit=topic.message_limit,
            ),
        )
        for topic in topics
    ]
    return await subscribe.read_several(source, requests, report)


@tool(
    title="Wait for a message",
    risk="read",
    recorded=True,
    aliases={"msg_type": "message_type"},
    finds="wait for next message, one current value of a topic",
)
async def ros2_topic_echo_wait(
    topic_name: TopicName,
    message_type: MessageType = "",
    timeout: Annotated[Number, Field(gt=0, le=MAX_DURATION_S, description="Maximum wait in seconds.")] = 5.0,
    *,
    selection: OneMessage,
    source: Source,
) -> subscribe.Echo:
    """Wait for the next message of a topic; the topic may appear while waiting.

    Images and maps come as pictures. From a recording: the next message from start on, or without start the
    last message.
    """
    return await subscribe.echo(source.lasting(timeout), topic_name, message_type, selection)


@tool(
    title="Rate and age of topics",
    risk="read",
    recorded=True,
    aliases={"duration": "duration_s"},
    program="rates",
    beside={"ros2_topic_statistics": "For the values of fields use ros2_topic_statistics."},
    finds="rate, Hz, frequency, bandwidth, delay, latency, lost messages",
)
async def ros2_topic_stats(
    report: Report,
    topic_names: Annotated[
        list[str] | None,
        Field(min_length=1, max_length=stats.MAX_TOPICS, description="Default: all published topics."),
    ] = None,
    duration_s: Annotated[
        Number | None,
        Field(gt=0, le=MAX_MEASURE_S, description="Measuring time in seconds. Default: 3, or the whole bag."),
    ] = None,
    *,
    source: Source,
) -> stats.Stats:
    """Measure the traffic of topics, several at once: rate, jitter, gaps, bandwidth, loss, age by header stamp.

    The largest come first.
    """
    lasting = source.lasting(duration_s or MEASURE_S, recorded_s=duration_s, whole=True)
    return await stats.measure(lasting, topic_names, report)


@tool(
    title="Publish",
    risk="actuate",
    does={"publish": ()},
    place=_PUBLISHING_PLACE,
    aliases={"msg_type": "message_type"},
    program="publish",
    finds="send a message, velocity command, cmd_vel, move by hand",
)
async def ros2_topic_publish(
    robot: Robot,
    session: Session,
    report: Report,
    topic_name: Destination,
    data: Data,
    message_type: PublishedType = "",
    frequency: Annotated[Number | None, Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ, description=_HZ)] = None,
    duration: Annotated[Number | None, Field(gt=0, le=MAX_DURATION_S, description=_SECONDS)] = None,
) -> publish.Published:
    """Publish a message once, or repeatedly with frequency and duration. Can move the robot.

    Values are checked against the definition first. The result says how many subscribers were reached. A repeated
    velocity command ends with a zero command.
    """
    request = publish.PublishRequest(
        topic_name=topic_name, message_type=message_type, data=data, frequency=frequency, duration=duration
    )
    return await publish.publish(robot, session, request, report)


@tool(
    title="Publish on several topics",
    risk="actuate",
    does={"publish": ()},
    place=_PUBLISHING_PLACE,
    finds="send on several topics together",
)
async def ros2_publish_multiple_topics(
    robot: Robot,
    session: Session,
    report: Report,
    topics: Annotated[list[TopicToPublish], _SEVERAL, Field(description="Topics and their messages.")],
) -> publish.PublishedSeveral:
    """Publish repeatedly on several topics at the same time, each with its own frequency and duration."""
    requests = [publish.PublishRequest(**dict(topic)) for topic in topics]
    return await publish.publish_several(robot, session, requests, report)
