"""The tool that asks for messages of the past."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from pydantic import Field

from ros2_mcp.ops.memory import messages as history
from ros2_mcp.ops.results import Report
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.source import SourceRequest
from ros2_mcp.tools.arguments import MessageType, TopicName, Whole
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import Messages

PLACE = 120

PastTime = Annotated[
    str, Field(description='ISO 8601 with zone, such as 2026-11-21T03:00:00.5Z, or relative: "last 30 s", "5 min ago".')
]


@tool(
    title="Messages of the past",
    risk="read",
    group="memory",
    aliases={"number_of_msg": "number_of_messages", "limit": "number_of_messages", "msg_type": "message_type"},
    recorded=True,
    also_named="ros2_get_messages_stored_in_influx_data_base",
)
async def ros2_get_messages(
    sources: Sources,
    report: Report,
    topic_name: TopicName,
    message_type: MessageType = "",
    number_of_messages: Annotated[Whole, Field(ge=0, le=100_000, description="Only the last N; 0: all.")] = 0,
    time_start: PastTime = "",
    time_end: PastTime = "",
    *,
    selection: Messages,
    bucket_name: Annotated[str, Field(description="Bucket of a Data Black Box that has several.")] = "",
) -> history.StoredMessages:
    """Get messages that were sent earlier, and say from where: a WiseVision Data Black Box, recordings, opened bags."""
    request = SourceRequest(start=time_start.strip(), end=time_end.strip(), bucket=bucket_name)
    chosen = replace(selection, message_limit=number_of_messages or None)
    return await history.get_messages(sources, topic_name, message_type, request, chosen, report)
