"""`ros2_nav_localize`: publish an initial pose that was given, found or kept, and measure whether localisation accepted
it and the scan fits the map."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import monotonic

from ros2_mcp.model.errors import ApprovalNeeded, BadInput, Refused
from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.find_pose import Found, PoseFit, find_pose, last_pose
from ros2_mcp.ops.navigation.known_places import places_of
from ros2_mcp.ops.navigation.last_pose import note_last_pose
from ros2_mcp.ops.navigation.scan_fit import ScanFit, scan_fit
from ros2_mcp.ops.navigation.targets import MAP_FRAME, Target, targets_of
from ros2_mcp.ops.navigation.whereabouts import Whereabouts, whereabouts
from ros2_mcp.ops.results.results import SAID, Report, silent
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
class LocalizeRequest:
    """Where the robot is: `at` a place or pose, or to be found. With `search`, `at` is a guess, and `radius_m` how far
    around it to search; `last` takes the pose that was kept."""

    at: object = None
    search: bool = False
    radius_m: float | None = None
    last: bool = False
    topic: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class NavLocalized:
    """The initial pose (m, degrees, in `frame`), and where the transforms say the robot is before and after.

    If `is_published` is false, nothing was sent, and `doubt` says why; x, y and yaw are then those of the best pose, if
    there is one. `is_taken`: whether localisation now has the robot at that pose (null: not known). `fit_before` and
    `fit_after` are the shares of laser beams that end at something on the map (null: not known). `found` has the poses
    that a search found, the best first, or the stored one.
    """

    topic_name: str
    frame: str
    x_m: float | None
    y_m: float | None
    yaw_deg: float | None
    is_published: bool = field(metadata=SAID)
    before: str = field(metadata=SAID)
    after: str = field(metadata=SAID)
    is_taken: bool | None
    fit_before: float | None = None
    fit_after: float | None = None
    fit: str = field(default="", metadata=SAID)
    found: Sequence[PoseFit] = field(default=(), metadata=SAID)
    how: str = field(default="", metadata=SAID)
    doubt: str = field(default="", metadata=SAID)
    note: str = field(default="", metadata=SAID)

    @property
    def has_failed(self) -> bool:
        """Whether localisation did not accept the pose, or nothing was published."""
        return not self.is_published or self.is_taken is False

    def summary(self) -> list[str]:
        """Return whether the pose was accepted, and how well the scan fits."""
        how = [self.how] if self.how else []
        if not self.is_published:
            several = [f"{number}. {pose}" for number, pose in enumerate(self.found, 1)]
            return [f"NOT localised, and nothing was published: {self.doubt}. {self.note}".rstrip(), *how, *several]
        verdict = {True: "Localised", False: "NOT localised there", None: "Told; not known whether it was taken"}
        told = f"({self.x_m:.2f}, {self.y_m:.2f}) facing {round(self.yaw_deg or 0)}° in {named(self.frame)}"
        first = f"{verdict[self.is_taken]}: {told}. Before: {self.before} Now: {self.after}"
        second = [f"The second best: {self.found[1]}."] if len(self.found) > 1 else []
        return [first, *how, *second, self.fit, *([self.note] if self.note else [])]


async def localize(robot: Robot, session: Session, request: LocalizeRequest, report: Report = silent) -> NavLocalized:
    """Publish an initial pose, and wait until the transforms place the robot there.

    A pose that was found, or kept, is published only if it is beyond doubt.

    Raises:
        BadInput: for a malformed place, or one without a heading if the present heading is unknown.
        NotFound: for an unknown place, if the topic has no subscriber, if there is nothing to search with, or no pose
            was kept.
        RobotError: what publishing raises.
    """
    target = _target(robot, request)
    listening = (await robot.graph.endpoints(request.topic or TOPIC)).subscribers
    if not any(not one.ours for one in listening):
        raise await robot.graph.missing(
            f"{named(request.topic or TOPIC)} has no subscriber: no localiser is running, or it uses another topic. "
            "Nothing was sent.",
            "ros2_topic_list pattern=initialpose shows such topics: give topic_name.",
        )
    before, fit_before = await asyncio.gather(whereabouts(robot, MAP_FRAME), scan_fit(robot))
    found: Found | None = None
    if request.search:
        found = await find_pose(robot, target, request.radius_m, report)
    elif request.last:
        found = await last_pose(robot, fit_before)
    if found and found.doubt:
        return _unpublished(request, found, before, fit_before)
    if found:
        first = found.poses[0]
        target = Target("", MAP_FRAME, first.x_m, first.y_m, math.radians(first.yaw_deg))
    assert target
    if target.yaw_rad is None:
        if before.yaw_rad is None:
            raise BadInput("The pose has no heading, and the robot's is not known.", "Give yaw_deg, or search=true.")
        target = replace(target, yaw_rad=before.yaw_rad)
    try:
        published = await publish(robot, session, _request(target, request.topic or TOPIC))
    except ApprovalNeeded as error:
        again = f" Once it is approved, call with at={found.poses[0]}." if found else ""  # another search differs a bit
        raise ApprovalNeeded(f"{error.message}{again}", error.hint, request_id=error.request_id) from error
    except Refused as error:
        best = f" {found.how} The best pose: {found.poses[0]}." if found else ""
        raise Refused(f"{error.message}{best}", error.hint) from error
    after, is_taken = await _taken(robot, target)
    fit_after = await scan_fit(robot)
    notes = [published.note, *session.notes]
    if isinstance(fit_after, ScanFit) and fit_after.of_all < _LOST:
        notes.append("The scan does NOT fit the map there: the pose is wrong, or the map is of another place.")
    if is_taken:
        await note_last_pose(robot)
    return NavLocalized(
        topic_name=published.topic_name,
        frame=target.frame,
        x_m=target.x_m,
        y_m=target.y_m,
        yaw_deg=round(math.degrees(target.yaw_rad or 0.0), 1),
        is_published=True,
        before=_in_words(before),
        after=_in_words(after),
        is_taken=is_taken,
        fit_before=fit_before.share if isinstance(fit_before, ScanFit) else None,
        fit_after=fit_after.share if isinstance(fit_after, ScanFit) else None,
        fit=f"Fit of the scan to the map: before {_fit(fit_before)}; now {_fit(fit_after)}.",
        found=found.poses if found else (),
        how=found.how if found else "",
        note=" ".join(filter(None, notes)),
    )


def _target(robot: Robot, request: LocalizeRequest) -> Target | None:
    """Return the pose or the guess that was given, if any; raises for arguments that contradict each other."""
    if request.radius_m is not None and not (request.search and request.at is not None):
        raise BadInput("radius_m is how far around a guess to search.", "Give search=true and `at` as well.")
    if request.last and (request.search or request.at is not None):
        raise BadInput(
            "`last` uses the pose that was stored: it goes neither with `at` nor with `search`.",
            "Give one of the three.",
        )
    if request.at is None:
        if request.search or request.last:
            return None
        raise BadInput(
            "`at` is missing: it says where the robot is.",
            "Give at=<a pose or a place>, search=true or last=true.",
        )
    (target, *more) = targets_of(request.at, places_of(robot))
    if more:
        raise BadInput("The robot can be at only one place.", "Give one pose, or the name of one place.")
    if target.frame != MAP_FRAME:
        raise BadInput(f"An initial pose is in {MAP_FRAME}, not in {named(target.frame)}.", "Give the pose in map.")
    return target


def _unpublished(
    request: LocalizeRequest, found: Found, before: Whereabouts, fit_before: ScanFit | str
) -> NavLocalized:
    first = found.poses[0] if found.poses else None
    helps = "Give the right pose as `at`; or search=true with `at`, a guess of where it is, and its yaw_deg."
    if request.last:
        helps = "To publish it all the same, give it as `at`; or search around it: search=true with `at` and radius_m."
    return NavLocalized(
        topic_name=request.topic or TOPIC,
        frame=MAP_FRAME,
        x_m=first.x_m if first else None,
        y_m=first.y_m if first else None,
        yaw_deg=first.yaw_deg if first else None,
        is_published=False,
        before=_in_words(before),
        after=_in_words(before),
        is_taken=None,
        fit_before=fit_before.share if isinstance(fit_before, ScanFit) else None,
        found=found.poses,
        how=found.how,
        doubt=found.doubt,
        note=f"{helps} Localisation has it at {_in_words(before)} There: {_fit(fit_before)}.",
    )


def _request(target: Target, topic: str) -> PublishRequest:
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = _SPREAD_M**2
    covariance[35] = _SPREAD_RAD**2
    header, pose = target.pose()["header"], target.pose()["pose"]
    # Whole, so that no note tells of fields left at their defaults. Without a stamp it is the latest transform's.
    header = {"stamp": {"sec": 0, "nanosec": 0}, **header}
    at = {"position": {"z": 0.0, **pose["position"]}, "orientation": {"x": 0.0, "y": 0.0, **pose["orientation"]}}
    data = {"header": header, "pose": {"pose": at, "covariance": covariance}}
    return PublishRequest(topic_name=topic, message_type=POSE_ESTIMATE, data=data)


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
    facing = "" if where.yaw_rad is None else f" facing {round(math.degrees(where.yaw_rad))}°"
    trouble = f" ({where.trouble.rstrip('.')})" if where.trouble else ""
    return f"({where.x_m:.2f}, {where.y_m:.2f}){facing}{trouble}."


def _fit(fit: ScanFit | str) -> str:
    return str(fit) if isinstance(fit, ScanFit) else f"not known ({fit})"
