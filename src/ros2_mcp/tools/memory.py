"""Tools for the past: record topics, read and play bags, and find stored messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from pydantic import Field

from ros2_mcp.ops.memory import bags, messages, play, record
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.source import SourceRequest
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import (
    BagEnd,
    BagName,
    BagStart,
    Flag,
    Limit,
    MessageType,
    NamePattern,
    Number,
    PastTime,
    TopicName,
    UpToPastTime,
    Whole,
)
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import Messages
from ros2_mcp_common.wire.limits import MAX_DURATION_S

PLACE = 130
HISTORY_PLACE = 120
"""Place of `ros2_get_messages`, which is offered by default; the other tools of this module come only with their
group."""

Bytes = Annotated[Whole, Field(ge=0, le=record.MAX_BYTES)]
Topics = Annotated[list[str] | None, Field(min_length=1, description="Only these topics.")]
RecordingId = Annotated[str, Field(description="ID from ros2_record_start. Default: the only running recording.")]
PlaybackId = Annotated[str, Field(description="ID from ros2_bag_play. Default: the only one.")]


@tool(
    title="Record topics",
    risk="write",
    does={"record": ()},
    group="memory",
    by_default=False,
    aliases={"topics": "topic_names", "max_duration_sec": "max_duration_s"},
    finds="record a bag, rosbag, save topics to a file",
)
async def ros2_record_start(
    robot: Robot,
    session: Session,
    store: BagStore,
    topic_names: Annotated[
        list[str] | None, Field(min_length=1, description="Topics to record, also if they appear later.")
    ] = None,
    patterns: Annotated[
        list[str] | None,
        Field(
            min_length=1, description="Globs such as /camera/*, or parts of names. Default without topic_names: all."
        ),
    ] = None,
    max_duration_s: Annotated[
        Number, Field(ge=0, le=604_800, description="Maximum duration in seconds; 0: no limit.")
    ] = 0.0,
    max_bytes: Annotated[Bytes, Field(description="Maximum size in bytes; 0: no limit.")] = 0,
    split_bytes: Annotated[Bytes, Field(description="Start a new file at this size in bytes; 0: never.")] = 0,
    name: Annotated[str, Field(max_length=200, description="Name of the recording. Default: the time.")] = "",
) -> record.RecordingState:
    """Start recording topics to disk (MCAP in a rosbag2 folder). The recording runs until a limit or ros2_record_stop.

    Latched messages are included; topics that appear later join within a second. Your calls are on /agent/calls.
    """
    request = record.RecordRequest(
        topics=topic_names or (),
        patterns=patterns or (),
        max_duration_s=max_duration_s,
        max_bytes=max_bytes,
        split_bytes=split_bytes,
        name=name,
    )
    return await record.start(robot, session, store, request)


@tool(title="Recordings", risk="read", group="memory", by_default=False, finds="is it recording, how large is the bag")
async def ros2_record_status(
    robot: Robot, recording_id: Annotated[str, Field(description="Only this recording. Default: all.")] = ""
) -> record.RecordingStates:
    """Show the state of recordings: messages, bytes and losses of each topic, and why a recording ended."""
    return await record.status(robot, recording_id)


@tool(title="Stop recording", risk="write", group="memory", by_default=False, finds="end a recording, close the bag")
async def ros2_record_stop(robot: Robot, recording_id: RecordingId = "") -> record.RecordingState:
    """End a recording and close its files."""
    return await record.stop(robot, recording_id)


@tool(
    title="List bags",
    risk="read",
    group="memory",
    by_default=False,
    recorded=True,
    finds="which bags, recordings, rosbag files are there",
)
async def ros2_bag_list(store: BagStore, pattern: NamePattern = "", limit: Limit = 200) -> bags.BagList:
    """List the bags (recordings) that can be read, the newest first."""
    return await bags.list_bags(store, pattern, limit)


@tool(
    title="What is in a bag",
    risk="read",
    group="memory",
    by_default=False,
    recorded=True,
    finds="what is in a bag: topics, duration, size",
)
async def ros2_bag_info(store: BagStore, bag: BagName) -> bags.BagInfo:
    """Show the topics, types, counts and times of a bag, and which parts are damaged or missing."""
    return await bags.info(store, bag)


@tool(
    title="Read a bag",
    risk="read",
    group="memory",
    by_default=False,
    recorded=True,
    aliases={"limit": "message_limit"},
    finds="read messages of a bag, recording, what happened",
)
async def ros2_bag_read(
    robot: Robot,
    store: BagStore,
    bag: BagName,
    topic_name: TopicName,
    start: BagStart = "",
    end: BagEnd = "",
    message_limit: Annotated[Whole, Field(ge=1, le=10_000, description="Maximum number of messages.")] = 20,
    *,
    selection: Messages,
) -> bags.BagMessages:
    """Read messages of one topic in a bag: the first messages from `start` on, or without `start` the last messages."""
    chosen = replace(selection, message_limit=message_limit)
    return await bags.read(robot, store, bag, topic_name, chosen, start=start, end=end)


@tool(
    title="Play a bag",
    risk="actuate",
    does={"play": ()},
    group="memory",
    by_default=False,
    aliases={"topics": "topic_names", "wait_sec": "wait_s"},
    finds="replay, play back a bag",
)
async def ros2_bag_play(
    robot: Robot,
    session: Session,
    store: BagStore,
    report: Report,
    bag: BagName,
    rate: Annotated[Number, Field(ge=0.01, le=100, description="Speed factor; 2: twice as fast.")] = 1.0,
    start: BagStart = "",
    end: BagEnd = "",
    topic_names: Topics = None,
    remaps: Annotated[dict[str, str] | None, Field(description='New names, such as {"/scan": "/old/scan"}.')] = None,
    loop: Annotated[Flag, Field(description="Start again at the end, until stopped.")] = False,
    force: Annotated[
        Flag,
        Field(description="Also publish on topics with a live publisher, and velocity commands that move the robot."),
    ] = False,
    wait_s: Annotated[
        Number,
        Field(
            ge=0,
            le=MAX_DURATION_S,
            description="Maximum wait for the end, in seconds; the playback continues afterwards.",
        ),
    ] = 40.0,
) -> play.PlaybackState:
    """Publish a bag's messages again with their timing. Can move the robot if the bag holds commands: choose topics."""
    request = play.PlayRequest(
        bag=bag, rate=rate, start=start, end=end, topics=topic_names or (), remaps=remaps or {}, loop=loop, force=force
    )
    return await play.play(robot, session, store, request, wait_s, report)


@tool(title="Playbacks", risk="read", group="memory", by_default=False, finds="how far is the playback")
async def ros2_bag_play_status(
    robot: Robot, playback_id: Annotated[str, Field(description="Only this playback. Default: all.")] = ""
) -> play.PlaybackStates:
    """Show the progress of bag playbacks, what was published, and why a playback ended."""
    return await play.status(robot, playback_id)


@tool(title="Stop playing", risk="write", group="memory", by_default=False, finds="end a playback")
async def ros2_bag_play_stop(robot: Robot, playback_id: PlaybackId = "") -> play.PlaybackState:
    """Stop playing a bag."""
    return await play.stop(robot, playback_id)


@tool(
    title="Messages of the past",
    risk="read",
    group="memory",
    aliases={"number_of_msg": "number_of_messages", "limit": "number_of_messages", "msg_type": "message_type"},
    recorded=True,
    place=HISTORY_PLACE,
    also_named="ros2_get_messages_stored_in_influx_data_base",
    finds="history, messages of the past, black box, what happened before",
)
async def ros2_get_messages(
    sources: Sources,
    report: Report,
    topic_name: TopicName,
    message_type: MessageType = "",
    number_of_messages: Annotated[Whole, Field(ge=0, le=100_000, description="Only the last N; 0: all.")] = 0,
    time_start: PastTime = "",
    time_end: UpToPastTime = "",
    *,
    selection: Messages,
    bucket_name: Annotated[str, Field(description="Bucket, if the Data Black Box has several.")] = "",
) -> messages.StoredMessages:
    """Get messages published earlier, from a WiseVision Data Black Box, recordings or opened bags; names the source."""
    names = ("time_start", "time_end")
    request = SourceRequest(start=time_start.strip(), end=time_end.strip(), bucket=bucket_name, names=names)
    chosen = replace(selection, message_limit=number_of_messages or None)
    return await messages.get_messages(sources, topic_name, message_type, request, chosen, report)
