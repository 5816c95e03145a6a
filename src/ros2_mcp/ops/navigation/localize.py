"""`ros2_nav_localize`: publish an initial pose, and measure whether localisation accepted it and the scan fits the
map."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass, field, replace
from time import monotonic

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.known_places import places_of
from ros2_mcp.ops.navigation.scan_fit import ScanFit, scan_fit
from ros2_mcp.ops.navigation.targets import MAP_FRAME, Target, targets_of
from ros2_mcp.ops.navigation.whereabouts import Whereabouts, whereabouts
from ros2_mcp.ops.results.results import SAID
from ros2_mcp.ops.topics.publish import PublishRequest, publish
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session

POSE_ESTIMATE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TOPIC = "/initialpose"
_TAKEN_S = 5.0
"""AMCL applies an initial pose with its next scan, and then publishes its transform."""
_LOOK_S = 0.3
_NEAR_M, _NEAR_RAD = 0.3, math.radians(15)
"""A localiser corrects the initial pose with its next scans, by about its standard deviation."""
_SPREAD_M, _SPREAD_RAD = 0.25, math.radians(15)
"""RViz uses a standard deviation of 0.5 m and 15°; half of the distance is enough for a known place."""
_LOST = 0.4
"""Share of the beams that fit. A well localised robot has 0.7 or more, even with people and boxes around it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NavLocalized:
    """The pose that was told (m, degrees, in `frame`), and where the transforms say the robot is before and after.

    `is_taken` says whether localisation now has it there (null: its pose is not known); `fit_before` and `fit_after`
    the share of laser beams that end at something the map has there (null: not known).
    """

    topic_name: str
    frame: str
    x_m: float
    y_m: float
    yaw_deg: float
    before: str = field(metadata=SAID)
    after: str = field(metadata=SAID)
    is_taken: bool | None
    fit_before: float | None = None
    fit_after: float | None = None
    fit: str = field(default="", metadata=SAID)
    note: str = ""

    @property
    def has_failed(self) -> bool:
        """Whether localisation did not accept the pose."""
        return self.is_taken is False

    def summary(self) -> list[str]:
        """Return whether the pose was accepted, and how well the scan fits."""
        verdict = {True: "Localised", False: "NOT localised there", None: "Told; not known whether it was taken"}
        told = f"({self.x_m:.2f}, {self.y_m:.2f}) facing {self.yaw_deg:.0f}° in {named(self.frame)}"
        return [f"{verdict[self.is_taken]}: {told}. Before: {self.before} Now: {self.after}", self.fit, *self._more()]

    def _more(self) -> list[str]:
        return [self.note] if self.note else []


async def localize(robot: Robot, session: Session, at: object, topic: str = "") -> NavLocalized:
    """Publish an initial pose, and wait until the transforms place the robot there.

    Raises:
        BadInput: for a malformed place, or one without a heading if the present heading is unknown.
        NotFound: for an unknown place, or if the topic has no subscriber.
        RobotError: what publishing raises.
    """
    (target, *more) = targets_of(at, places_of(robot))
    if more:
        raise BadInput("The robot is at one place.", "Give one pose, or the name of one place.")
    if target.frame != MAP_FRAME:
        raise BadInput(f"An initial pose is in {MAP_FRAME}, not in {named(target.frame)}.", "Give the pose in map.")
    listening = (await robot.graph.endpoints(topic or TOPIC)).subscribers
    if not any(not one.ours for one in listening):
        raise await robot.graph.missing(
            f"Nobody listens to {named(topic or TOPIC)}: no localiser runs, or on another topic. Nothing was sent.",
            "ros2_topic_list pattern=initialpose shows such topics: give topic_name.",
        )
    before, fit_before = await asyncio.gather(whereabouts(robot, MAP_FRAME), scan_fit(robot))
    if target.yaw_rad is None:
        if before.yaw_rad is None:
            raise BadInput("The pose has no heading, and the robot's is not known.", "Give yaw_deg.")
        target = replace(target, yaw_rad=before.yaw_rad)
    published = await publish(robot, session, _request(target, topic or TOPIC))
    after, is_taken = await _taken(robot, target)
    fit_after = await scan_fit(robot)
    notes = [published.note, *session.notes]
    if isinstance(fit_after, ScanFit) and fit_after.share < _LOST:
        notes.append("The scan does NOT fit the map there: the pose is wrong, or the map is of another place.")
    return NavLocalized(
        topic_name=published.topic_name,
        frame=target.frame,
        x_m=target.x_m,
        y_m=target.y_m,
        yaw_deg=round(math.degrees(target.yaw_rad or 0.0), 1),
        before=_in_words(before),
        after=_in_words(after),
        is_taken=is_taken,
        fit_before=fit_before.share if isinstance(fit_before, ScanFit) else None,
        fit_after=fit_after.share if isinstance(fit_after, ScanFit) else None,
        fit=f"Fit of the scan to the map: before {_fit(fit_before)}; now {_fit(fit_after)}.",
        note=" ".join(filter(None, notes)),
    )


def _request(target: Target, topic: str) -> PublishRequest:
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = _SPREAD_M**2
    covariance[35] = _SPREAD_RAD**2
    stamped = target.pose()
    pose = {"pose": stamped["pose"], "covariance": covariance}
    return PublishRequest(
        topic_name=topic, message_type=POSE_ESTIMATE, data={"header": stamped["header"], "pose": pose}
    )


async def _taken(robot: Robot, target: Target) -> tuple[Whereabouts, bool | None]:
    """Wait until the transforms place the robot near the target, or for some seconds; return the robot's pose, and
    whether it is near (None: unknown)."""
    end = monotonic() + _TAKEN_S
    while True:
        where = await whereabouts(robot, MAP_FRAME)
        if where.x_m is not None and where.y_m is not None and not where.trouble:
            away_m = math.hypot(where.x_m - target.x_m, where.y_m - target.y_m)
            turned = abs(math.remainder((where.yaw_rad or 0.0) - (target.yaw_rad or 0.0), 2 * math.pi))
            if away_m < _NEAR_M and turned < _NEAR_RAD:
                return where, True
        if monotonic() > end:
            return where, None if where.trouble or where.x_m is None else False
        await asyncio.sleep(_LOOK_S)


def _in_words(where: Whereabouts) -> str:
    if where.x_m is None or where.y_m is None:
        return f"unknown ({where.trouble.rstrip('.')})."
    facing = "" if where.yaw_rad is None else f" facing {math.degrees(where.yaw_rad):.0f}°"
    trouble = f" ({where.trouble.rstrip('.')})" if where.trouble else ""
    return f"({where.x_m:.2f}, {where.y_m:.2f}){facing}{trouble}."


def _fit(fit: ScanFit | str) -> str:
    return str(fit) if isinstance(fit, ScanFit) else f"not known ({fit})"
