"""Tools that publish."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AliasChoices, BaseModel, ConfigDict, Field

from ros2_mcp.ops.results import Report
from ros2_mcp.ops.topics import publish as publishing
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import MessageType, Number, TopicName
from ros2_mcp.tools.declare import tool
from ros2_mcp_bridge.limits import MAX_DURATION_S, MAX_RATE_HZ

PLACE = 60

Data = Annotated[
    dict[str, Any],
    Field(description='The message\'s fields, such as {"linear": {"x": 0.2}}. Fields left out get their default.'),
]
_HZ = "How often per second, with duration."
_SECONDS = "For how long, in seconds, with frequency."


class TopicToPublish(BaseModel):
    """One topic of `ros2_publish_multiple_topics`."""

    model_config = ConfigDict(extra="forbid")

    topic_name: TopicName
    message_type: Annotated[MessageType, Field(validation_alias=AliasChoices("message_type", "msg_type"))] = ""
    data: Data
    frequency: Annotated[Number, Field(gt=0, le=MAX_RATE_HZ, description=_HZ)] = 1.0
    duration: Annotated[Number, Field(gt=0, le=MAX_DURATION_S, description=_SECONDS)] = 5.0


@tool(title="Publish", risk="actuate", aliases={"msg_type": "message_type"})
async def ros2_topic_publish(
    robot: Robot,
    report: Report,
    topic_name: TopicName,
    data: Data,
    message_type: MessageType = "",
    frequency: Annotated[Number | None, Field(gt=0, le=MAX_RATE_HZ, description=_HZ)] = None,
    duration: Annotated[Number | None, Field(gt=0, le=MAX_DURATION_S, description=_SECONDS)] = None,
) -> publishing.Published:
    """Publish a message once, or repeatedly with frequency and duration. Can move the robot.

    Values are checked against the definition first. The result says how many subscribers were reached. A repeated
    velocity command ends with a zero command.
    """
    publication = publishing.Publication(topic_name, message_type, data, frequency, duration)
    return await publishing.publish(robot, publication, report)


@tool(title="Publish on several topics", risk="actuate")
async def ros2_publish_multiple_topics(
    robot: Robot,
    report: Report,
    topics: Annotated[list[TopicToPublish], Field(min_length=1, max_length=20, description="What to publish where.")],
) -> publishing.PublishedSeveral:
    """Publish repeatedly on several topics at the same time, each with its own frequency and duration."""
    publications = [
        publishing.Publication(t.topic_name, t.message_type, t.data, t.frequency, t.duration) for t in topics
    ]
    return await publishing.publish_several(robot, publications, report)
