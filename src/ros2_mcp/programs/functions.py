"""Functions that only programs have: reading messages in sequence, a scan, a picture, a turn, and stopping its own
motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

from ros2_mcp.model.errors import BadData, BadInput
from ros2_mcp.model.pictures import LASER_SCAN
from ros2_mcp.model.text import named
from ros2_mcp.ops.motion.drive import Driven, DriveRequest, drive
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.topics.subscribe import echo
from ros2_mcp.programs.declare import Use, function
from ros2_mcp.programs.sandbox import LONGEST_S
from ros2_mcp.programs.streams import FollowRequest
from ros2_mcp.programs.stub import Stream
from ros2_mcp.robot.goals import Goal
from ros2_mcp_common.language.scans import limits_of, no_bearings


@function()
async def latest(
    use: Use, topic_name: str, fields: Sequence[str] | None = None, timeout: float = 5.0, bag: str = ""
) -> dict[str, Any]:
    """The newest message of a topic; waits only for the first message."""
    source = await use.sources.open(bag, waits=False, report=use.report)
    if source.is_live:
        return await use.streams.latest(source.judging().lasting(LONGEST_S).prompt(), topic_name, fields or (), timeout)
    number = await use.streams.follow(source, FollowRequest(topics=[topic_name], fields=fields or (), count=1))
    message = await use.streams.next(number)
    if message is None:
        raise BadInput(f"The recording has no message of {topic_name}.", "robot.topics() shows what it has.")
    await use.streams.next(number)
    return message


@function()
async def messages(
    *topic_names: str,
    use: Use,
    fields: Sequence[str] | None = None,
    duration: float | None = None,
    message_limit: int | None = None,
    every_n: int = 1,
    bag: str = "",
    start: str = "",
    end: str = "",
) -> Stream:
    """Every message of these topics in order, for a `for` loop."""
    if not topic_names:
        raise BadInput("No topic is given.", 'Write for message in robot.messages("/odom"): …')
    source = await use.sources.open(bag, start, end, waits=duration is not None, report=use.report)
    lasting = source.lasting(LONGEST_S if duration is None else duration, recorded_s=duration, whole=True)
    wanted = FollowRequest(topics=topic_names, fields=fields or (), count=message_limit, every_n=every_n)
    return await use.follow(lasting.prompt(), wanted)


@function(recorded=False)
async def feedback(use: Use, goal: Any) -> Stream:
    """Every feedback message of a goal that `goal(…)` has sent, until the goal ends, for a `for` loop."""
    given: Mapping[str, Any] = {"goal_id": goal}
    if isinstance(goal, Mapping):
        given = cast("Mapping[str, Any]", goal)
    goal_id = given.get("goal_id")
    sent = use.robot.jobs.get(Goal, str(goal_id))
    if sent is None and goal_id and given.get("accepted", True):
        raise BadInput(
            "This is not a goal of this server.", "Write goal = robot.goal(…), then for m in robot.feedback(goal)."
        )
    return use.follow_goal(sent)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """A laser scan by angle: `beams` are [degrees to the left, m], without invalid ranges; inf means no echo.

    `nearest_m` is None if there is no obstacle within range.
    """

    topic_name: str
    beams: Sequence[Sequence[float]]
    nearest_m: float | None
    nearest_deg: float | None
    age_s: float | None


@function()
async def scan(use: Use, topic_name: str = "", timeout: float = 5.0, bag: str = "") -> Scan:
    """The newest laser scan by angle; without a name, that of the only scanner."""
    source = await use.sources.open(bag, waits=False, report=use.report)
    if not topic_name:
        found = await source.publishing(LASER_SCAN)
        if len(found) != 1:
            raise BadInput(f"There are {len(found)} laser scans: {', '.join(map(named, found))}.", "Name one of them.")
        topic_name = found[0]
    message = await latest(use=use, topic_name=topic_name, timeout=timeout, bag=bag)
    if "angle_increment" not in message:
        raise BadInput(f"{named(topic_name)} is not a laser scan.", "robot.topics() shows the types.")
    told = SimpleNamespace(**message)
    if why := no_bearings(told):
        raise BadData(f"The scan of {named(topic_name)} has no bearings: {why}.")
    least, most = limits_of(told)
    beams: list[list[float]] = []
    for index, metres in enumerate(message["ranges"]):
        degrees = math.degrees(message["angle_min"] + index * message["angle_increment"])
        if metres >= least:  # false for NaN
            beams.append([round(degrees, 2), metres if metres <= most else math.inf])
    hit = min((beam for beam in beams if beam[1] < math.inf), key=lambda beam: beam[1], default=None)
    return Scan(
        topic_name=message["_topic"],
        beams=beams,
        nearest_m=hit[1] if hit else None,
        nearest_deg=hit[0] if hit else None,
        age_s=message.get("_age_s"),
    )


@function()
async def picture(use: Use, topic_name: str, timeout: float = 5.0, bag: str = "") -> dict[str, Any]:
    """Show a picture of a camera to the model when the program has ended."""
    source = await use.sources.open(bag, waits=False, report=use.report)
    found = await echo(source.lasting(timeout), topic_name, "", Selection())
    if not found.images:
        raise BadInput(f"{named(topic_name)}: no picture. {found.note}".rstrip(), "Give a topic of images.")
    use.keep(found.images[0])
    return {"width": found.images[0].width, "height": found.images[0].height, "note": found.images[0].note}


@function(risk="act", recorded=False)
async def turn(use: Use, angle_deg: float, speed: float | None = None) -> Driven:
    """Turn in place by odometry; positive: left."""
    return await drive(use.robot, use.session, DriveRequest(angle_deg=angle_deg, speed=speed), use.report)


@function(risk="act", recorded=False)
async def stop(use: Use) -> list[str]:
    """End everything that this program has in motion; the program continues."""
    return await use.stop_own()
