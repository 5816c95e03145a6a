"""Tools for relays from topic to topic."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ros2_mcp.ops.relay import relay
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import MessageType, Number
from ros2_mcp.tools.declare import tool
from ros2_mcp_common.wire.limits import MAX_RATE_HZ, MIN_RATE_HZ

PLACE = 110

Tolerances = Annotated[
    dict[str, Number],
    Field(
        description='With on_change: differences up to this are no change: {"pose.position.x": 0.05}; "*": every '
        "number. In other fields any difference counts; header stamps never do."
    ),
]
Mapping = Annotated[
    dict[str, str],
    Field(
        description='If the destination has another type: {"destination field": "source field"}; other fields get '
        "defaults."
    ),
]


@tool(
    title="Start a relay",
    risk="actuate",
    does={"relay": ()},
    group="relay",
    finds="forward a topic, throttle, republish, convert, filter",
)
async def ros2_relay_start(
    robot: Robot,
    session: Session,
    source_topic: Annotated[str, Field(description="Topic to read.")],
    destination_topic: Annotated[str, Field(description="Topic to publish on.")],
    message_type: MessageType = "",
    transform: Annotated[
        Literal["identity", "rate_limit", "on_change", "filter"],
        Field(
            description="identity: all messages; rate_limit: at most target_rate_hz; on_change, filter: only changes."
        ),
    ] = "identity",
    target_rate_hz: Annotated[
        Number | None,
        Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ, description="With rate_limit: maximum messages per second; default 10."),
    ] = None,
    duration_sec: Annotated[Number, Field(ge=0, le=86400, description="Duration in seconds; 0: until stopped.")] = 60.0,
    tolerances: Tolerances | None = None,
    mapping: Mapping | None = None,
    destination_type: Annotated[
        str, Field(description="With a mapping: type of a destination that has none yet.")
    ] = "",
) -> relay.RelayState:
    """Republish the messages of one topic on another, in the background. Can move the robot.

    Returns a relay_id at once. The relay ends after its duration, with ros2_relay_stop or ros2_stop, and with this
    server; velocity topics then get a zero command.
    """
    request = relay.RelayRequest(
        source_topic=source_topic,
        destination_topic=destination_topic,
        message_type=message_type,
        transform=transform,
        target_rate_hz=target_rate_hz,
        duration_s=duration_sec,
        tolerances=tolerances or {},
        mapping=mapping or {},
        destination_type=destination_type,
    )
    return await relay.start(robot, session, request)


@tool(title="List relays", risk="read", group="relay", finds="which relays are running")
async def ros2_relay_list(robot: Robot) -> relay.RelayList:
    """List this server's relays with the messages published and filtered out, and the relays that ended last."""
    return await relay.list_relays(robot)


@tool(title="Stop a relay", risk="write", group="relay", finds="end a relay")
async def ros2_relay_stop(
    robot: Robot, relay_id: Annotated[str, Field(description="ID from ros2_relay_start. Default: the only one.")] = ""
) -> relay.RelayState:
    """Stop a relay; returns its final counts."""
    return await relay.stop(robot, relay_id)
