"""`ros2_scene`: one picture to scale of the grid, the robot, its scans, paths, goals and named places."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from ros2_mcp.model import names
from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import BadData, BadInput, NotFound, RobotError, TimedOut
from ros2_mcp.model.nav2 import COSTMAP, PATH
from ros2_mcp.model.pictures import BOUNDS, LASER_SCAN, OCCUPANCY_GRID, Picture, Place, RobotPlace
from ros2_mcp.model.poses import Pose, planar
from ros2_mcp.model.text import listed, named
from ros2_mcp.model.times import recorded_time, seconds_from_start
from ros2_mcp.ops.navigation.costmaps import Costmap, chosen_costmaps, costmap_of
from ros2_mcp.ops.navigation.known_places import NamedPlace, places_of
from ros2_mcp.ops.navigation.navigate import Navigation
from ros2_mcp.ops.pictures.next_message import Next, next_message
from ros2_mcp.ops.pictures.robot_place import placed, robot_place
from ros2_mcp.ops.results.results import Report, facts, iso_time, reporting, silent
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.space.ages import age_of, since_s, stamp_ns
from ros2_mcp.ops.space.frames import WORLDS, frames_of
from ros2_mcp.ops.space.meaning import meaning_of
from ros2_mcp.ops.space.plans import plans_of, sent_before
from ros2_mcp.ops.space.scene_picture import SceneLayer, ScenePicture, SceneRequest, Way
from ros2_mcp.ops.space.silhouette import silhouette_of
from ros2_mcp.robot import Robot
from ros2_mcp.world.limbs import Limb, LimbSeen, limbs_seen
from ros2_mcp.world.transforms import FrameTree, Located, pose_of
from ros2_mcp_common.finite import not_finite

if TYPE_CHECKING:
    from ros2_mcp.pictures.scene import GridLayer, Mark, Scene, SceneDrawing, Zone

POSE_STAMPED, POLYGON, STRING = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PolygonStamped",
    "std_msgs/msg/String",
)
_GRID_S = 4.0
"""Time to wait for a map: it is latched, but its publisher may be discovered up to 3 s late."""
_LAYER_S = 1.2
"""Time to wait for other layers: they are published at 1 Hz or more; a silent layer must not delay the picture."""
_FRAMES_S = 1.0
"""Time to wait for frames not used before: transforms are published at 10 Hz, static transforms are latched."""
_BEFORE_NS = 10_000_000_000
"""The part of a recording before the time shown in which transforms are read: as much as tf2 keeps."""
_MOST_SCANS, _MOST_PATHS, _MOST_GOALS = 3, 4, 4
"""The most layers of a kind: more in one picture cannot be told apart."""
_MOST_PLACES, _MOST_POINTS = 40, 2_000
"""The most named places, and points of a path: more than the picture has pixels across."""
_OLD_S = 3.0
"""A scan or pose older than this is not current: every driver publishes both several times a second."""
_LATE_S = 0.5
"""Age from which a scan's directions are in doubt: a robot that turns at 1 rad/s faces elsewhere by then."""
_COSTMAP, _DESCRIPTION = "costmap", "description"


async def scene(robot: Robot, source: Source, request: SceneRequest, report: Report = silent) -> ScenePicture:
    """Return the scene, now or at the end of the selected part of a recording.

    Raises:
        NotFound: if the grid or the frame is not there.
        BadData: if there is nothing at all to show, or the grid does not fit its size.
    """
    return await _picture(await gather(robot, source, request, report), request)


async def gather(robot: Robot, source: Source, request: SceneRequest, report: Report = silent) -> Gathered:
    """Read everything around the robot and transform it into one frame, for a picture or for the view; raises as
    `scene`.
    """
    await load("ros2_mcp.pictures.scene", "ros2_mcp.world.scans")  # with numpy: not before it is needed
    gathered = Gathered(source, robot)
    async with reporting(report, _GRID_S, "gathering what is around the robot"):
        await asyncio.gather(gathered.read(request), gathered.listen())
        await gathered.locate(request)
        gathered.at_ns = source.covers_ns[1] if source.covers_ns else robot.now_ns()
        await gathered.place(robot)
        if request.way:
            gathered.place_way(request.way)
    return gathered


@dataclass
class Gathered:
    """The layers read so far, and their places in `frame` at the time `at_ns`."""

    source: Source
    asked: Robot
    grid: Costmap | None = None
    grid_topic: str = ""
    read_layers: list[tuple[str, str, Next]] = field(default_factory=list[tuple[str, str, Next]])
    frame: str = ""
    at_ns: int = 0
    tree: FrameTree = field(default_factory=FrameTree)
    robot: RobotPlace | None = None
    layers: list[SceneLayer] = field(default_factory=list[SceneLayer])
    missing: list[str] = field(default_factory=list[str])
    grid_layer: GridLayer | None = None
    footprint: Any = None
    limbs: Sequence[LimbSeen] = ()
    scans: list[Any] = field(default_factory=list[Any])
    paths: list[Any] = field(default_factory=list[Any])
    path_names: list[str] = field(default_factory=list[str])
    goals: list[Mark] = field(default_factory=list["Mark"])
    places: list[Mark] = field(default_factory=list["Mark"])
    zones: list[Zone] = field(default_factory=list["Zone"])
    sent_to: set[str] = field(default_factory=set[str])

    # ── reading ────────────────────────────────────────────────────────────────────────────────────────────────

    async def listen(self) -> None:
        """Subscribe to transforms while the layers are read: a scan that waited for them would be old."""
        with suppress(RobotError):  # `locate` reports it
            if self.source.transforms:
                await self.source.transforms.listening()

    async def read(self, request: SceneRequest) -> None:
        """Read all layers."""
        source = self.source
        kinds = (OCCUPANCY_GRID, COSTMAP, LASER_SCAN, PATH, POSE_STAMPED, POLYGON, STRING)
        grids, raw, scans, paths, poses, polygons, texts = await asyncio.gather(*map(source.publishing, kinds))
        self.grid_topic = _chosen_grid(request.grid, chosen_costmaps(grids, raw))
        grid_type = COSTMAP if self.grid_topic in raw else OCCUPANCY_GRID
        goals = [name for name in poses if "goal" in name.rpartition("/")[2]]
        if source.is_live:
            await plans_of(self.asked).hear([*paths, *goals])
        shown = [] if request.way else paths  # a path given by the caller is not drawn twice
        wanted = [("path", name, PATH) for name in self._first("paths", shown, _MOST_PATHS)]
        wanted += [("goal", name, POSE_STAMPED) for name in self._first("goals", goals, _MOST_GOALS)]
        footprints = [("footprint", name, POLYGON) for name in polygons if "footprint" in name]
        descriptions = [(_DESCRIPTION, name, STRING) for name in texts if name.endswith("robot_description")]
        wanted += [*footprints[:1], *descriptions[:1]]
        # Scans come last: they must fit the pose shown, and the robot may turn while other messages are awaited.
        late = [("scan", name, LASER_SCAN) for name in self._first("scans", scans, _MOST_SCANS)]
        results, error = await asyncio.gather(self._read_all(wanted), self._read_grid(grid_type))
        if error and request.grid:
            raise error
        if error:
            self.missing.append(f"The grid {named(self.grid_topic)} is not shown: {error.message}")
        results += await self._read_all(late)
        for (layer, name, _), found in zip([*wanted, *late], results, strict=True):
            if isinstance(found, Next):
                self.read_layers.append((layer, name, found))
                self._tell_skipped(name, found)
            elif layer in ("scan", "path"):
                self.missing.append(f"The {layer} {named(name)} is not shown: {found.message}")

    async def _read_all(self, layers: Sequence[tuple[str, str, str]]) -> list[Next | RobotError]:
        """Return the next message of each layer (kind, topic, type), awaited at the same time."""
        return [*await asyncio.gather(*(self._read_layer(*layer) for layer in layers))]

    async def _read_layer(self, layer: str, topic: str, type_name: str) -> Next | RobotError:
        """Return the next message; for a path or goal, which are published once, live the latest message received, if
        any.

        A topic that has been subscribed to since an earlier call is not waited for again.
        """
        heard_s = plans_of(self.asked).heard_s(topic) if self.source.is_live and layer in ("path", "goal") else 0.0
        found: Next | RobotError
        if heard_s > _LAYER_S:
            was_sent = plans_of(self.asked).last(topic) is not None
            why = "The last one is empty." if was_sent else "Nothing was sent so far."
            found = TimedOut(why)
        else:
            found = await _next(self.source, topic, type_name, _LAYER_S)
        if not heard_s or isinstance(found, Next) or not (before := await sent_before(self.asked, topic, type_name)):
            return found
        message, ago_s = before
        if ago_s <= _LAYER_S:
            return message
        if layer == "goal":  # the robot may have reached it since
            return found
        self.missing.append(f"The path {named(topic)} was published {ago_s:.0f} s ago, and not since.")
        return message

    async def _read_grid(self, type_name: str) -> RobotError | None:
        """Read the grid with its updates; return the error if it cannot be read."""
        topic = self.grid_topic
        if not topic:
            return None
        try:
            self.grid = await costmap_of(self.asked, self.source, topic, type_name, _GRID_S)
        except RobotError as error:
            return error
        self._tell_skipped(topic, self.grid)
        if not self.grid.is_complete:
            self.missing.append(self.grid.note)
        return None

    def _tell_skipped(self, name: str, found: Next | Costmap) -> None:
        if found.skipped:
            self.missing.append(f"{named(name)}: {found.skipped}")

    def _first(self, what: str, found: Sequence[str], most: int) -> Sequence[str]:
        if len(found) > most:
            self.missing.append(f"Not shown, of {len(found)} {what}: {listed(found[most:], 8)}.")
        return found[:most]

    # ── frames ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def locate(self, request: SceneRequest) -> None:
        """Choose the frame of the picture, get the transforms to it, and find the robot's pose in it."""
        source = self.source
        if source.covers_ns:  # frames not connected in this part have no place in the picture
            source = source.part(source.covers_ns[1] - _BEFORE_NS, source.covers_ns[1])
        try:
            self.tree = await frames_of(source, until=lambda _: True)
            self._choose_frame(request)
            self.tree = await frames_of(source, until=self._is_complete, patience_s=_FRAMES_S)
        except RobotError as error:  # a robot without transforms may still have a map
            self.missing.append(f"Without transforms only what is in one frame is shown: {error.message}")
        self._choose_frame(request)
        if request.frame and self.frame not in self.tree.frames and self.frame not in self._frames_of_messages():
            known = sorted(self.tree.frames)
            raise NotFound(f"There is no frame {named(self.frame)}.", names.did_you_mean(self.frame, known, ""))
        found = self.tree.newest(self.frame, self.tree.base) if self.tree.base else None
        if found:
            self.robot = placed(found.pose, found.stamp_ns)
        else:
            self.robot = await robot_place(self.source, self.frame)
        if self.robot is None:
            self.missing.append(f"The robot is not shown: nothing reports its place in {named(self.frame)}.")

    def _choose_frame(self, request: SceneRequest) -> None:
        of_messages = self._frames_of_messages()
        tree = self.tree
        standard = [name for name in WORLDS if name in tree.frames]
        self.frame = (
            request.frame.strip().lstrip("/")
            or (of_messages[0] if self.grid and of_messages else "")
            or (standard[0] if standard else "")
            or tree.base
            or (of_messages[0] if of_messages else "")
        )

    def _frames_of_messages(self) -> list[str]:
        headers = [self.grid.grid.header] if self.grid else []
        headers += [found.message.header for kind, _, found in self.read_layers if kind != _DESCRIPTION]
        return [header.frame_id.lstrip("/") for header in headers]

    def _is_complete(self, tree: FrameTree) -> bool:
        """Return whether every layer can be placed, the scans at the times of their stamps."""
        if tree.base and not tree.newest(self.frame, tree.base):
            return False
        scans = [found.message.header for kind, _, found in self.read_layers if kind == "scan"]
        return bool(tree.base) and all(
            tree.find(self.frame, header.frame_id.lstrip("/"), stamp_ns(header)) for header in scans
        )

    def _located(self, header: Any) -> Pose | None:
        """Return the pose of a message's frame at the message's stamp, in the picture's frame as it is now.

        The two are related through the root of the tree: a moving frame, such as base_link, has moved since.
        """
        frame, root = header.frame_id.lstrip("/"), self.tree.root_of(self.frame)
        if frame == self.frame and frame == root:
            return Pose()
        at_ns = stamp_ns(header)
        then: Located | None = self.tree.find(root, frame, at_ns) if at_ns else None
        then, now = then or self.tree.newest(root, frame), self.tree.newest(self.frame, root)
        if then and now:
            return now.pose @ then.pose
        return Pose() if frame == self.frame else None

    # ── placing ────────────────────────────────────────────────────────────────────────────────────────────────

    async def place(self, robot: Robot) -> None:
        """Transform every layer into the frame of the picture."""
        now_ns = self.at_ns
        if self.grid:
            self._place_grid(self.grid, now_ns)
        for kind, name, found in self.read_layers:
            if kind == _DESCRIPTION:
                await self._place_body(name, found.message.data)
                continue
            pose = self._located(found.message.header)
            if pose is None:
                self._unplaced(kind, name, found.message.header)
                continue
            age_s = age_of(found.message.header, found.sample, now_ns)
            _PLACERS[kind](self, name, found.message, pose, age_s)
            if found.age and self.layers and self.layers[-1].name == name:
                self.layers[-1] = replace(self.layers[-1], from_before=found.age)
        self._place_named(robot)
        if self.source.is_live:
            self._place_zones(robot)

    def tell_age(self, name: str, scan: Next) -> None:
        """Report that a scan is older than the robot's pose, if the robot may have turned since."""
        age_s = age_of(scan.message.header, scan.sample, self.at_ns)
        if age_s is not None and age_s > _LATE_S:
            self.missing.append(
                f"The scan {named(name)} is {age_s:.1f} s old: if the robot has turned since, its directions no longer "
                "hold."
            )

    def _place_grid(self, found: Costmap, now_ns: int) -> None:
        from ros2_mcp.pictures.scene import GridLayer

        grid, costs = found.grid, _COSTMAP in self.grid_topic
        kind = _COSTMAP if costs else "grid"
        pose = self._located(grid.header)
        if pose is None:
            self._unplaced(kind, self.grid_topic, grid.header)
            return
        self.grid_layer = GridLayer(grid, _place(pose @ grid.origin), costs)
        age_s = since_s(found.newest_ns, now_ns) if found.newest_ns else age_of(grid.header, found.sample, now_ns)
        self.layers.append(SceneLayer(kind, self.grid_topic, age_s=age_s, from_before=found.age))

    def _unplaced(self, kind: str, name: str, header: Any) -> None:
        self.missing.append(
            f"The {kind} {named(name)} is not shown: no transforms connect its frame {named(header.frame_id)} with "
            f"{named(self.frame)}."
        )

    def place_scan(self, name: str, message: Any, pose: Pose, age_s: float | None) -> None:
        """Add the points of a scan."""
        from ros2_mcp.world.scans import moved, scan_points

        try:
            self.scans.append(moved(scan_points(message).hits, pose)[:, :2])
        except BadData as error:
            self.missing.append(f"The scan {named(name)} is not shown: {error.message}")
            return
        self.layers.append(SceneLayer("scan", name, age_s=age_s))

    def place_path(self, name: str, message: Any, pose: Pose, age_s: float | None) -> None:
        """Add the points of a path."""
        import numpy as np  # not at the start of the server

        poses = [*message.poses[:: max(1, len(message.poses) // _MOST_POINTS)], *message.poses[-1:]]
        points = [(one.pose.position.x, one.pose.position.y, one.pose.position.z) for one in poses]
        ends = [pose.applied(point)[:2] for point in points if all(map(math.isfinite, point))]
        if why := not_finite(message, "poses") if len(ends) < len(points) else "":
            left_out = "some of its places are" if ends else "it is"
            self.missing.append(f"The path {named(name)}: {left_out} not shown, because {why}.")
        if not ends:  # planners withdraw a path by publishing an empty one
            return
        self.paths.append(np.array(ends))
        self.path_names.append(name)
        self.layers.append(SceneLayer("path", name, round(ends[-1][0], 3), round(ends[-1][1], 3), age_s=age_s))

    def place_footprint(self, name: str, message: Any, pose: Pose, age_s: float | None) -> None:
        """Add the corners of a footprint."""
        import numpy as np  # not at the start of the server

        if why := not_finite(message, "polygon"):
            self.missing.append(f"The footprint {named(name)} is not shown: {why}.")
            return
        corners = [pose.applied((corner.x, corner.y, corner.z))[:2] for corner in message.polygon.points[:_MOST_POINTS]]
        if len(corners) > 2:
            self.footprint = np.array(corners)
            self.layers.append(SceneLayer("footprint", name, age_s=age_s))

    async def _place_body(self, name: str, description: str) -> None:
        """Add the footprint of the robot from its description, at the robot's pose, and the links that joints move."""
        import numpy as np  # not at the start of the server

        at = self.robot
        try:
            body = await aside(len(description), silhouette_of, description, self.tree.base)
        except BadData:  # an invalid description is reported by other tools
            return
        if at and body.outline and self.footprint is None:
            pose = planar(at.x_m, at.y_m, at.yaw_rad)
            self.footprint = np.array([pose.applied((x, y, 0.0))[:2] for x, y in body.outline])
            self.layers.append(SceneLayer("footprint", name))
        self._place_limbs(name, body.limbs)

    def _place_limbs(self, name: str, limbs: Sequence[Limb]) -> None:
        places = {limb.link: self.tree.newest(self.frame, limb.link) for limb in limbs}
        told = [found.stamp_ns for found in places.values() if found and found.stamp_ns]
        self.limbs = limbs_seen(limbs, self._now_in)
        if self.limbs:
            age_s = since_s(min(told, default=None), self.at_ns)
            self.layers.append(SceneLayer("links", name, age_s=age_s))
            if age_s is not None and age_s > _OLD_S:
                self.missing.append(f"The positions of the moving links are {age_s:.1f} s old.")
        if unknown := [link for link, found in places.items() if not found]:
            self.missing.append(f"No transform gives the position of these links: {listed(unknown, 4)}.")

    def place_goal(self, name: str, message: Any, pose: Pose, age_s: float | None) -> None:
        """Add the pose of a goal."""
        try:
            at = _place(pose @ pose_of(message.pose))
        except ValueError as error:
            self.missing.append(f"The goal {named(name)} is not shown: {error}.")
            return
        self._mark("goal", name, at.x_m, at.y_m, at.yaw_rad, age_s)

    def _place_named(self, robot: Robot) -> None:
        """Add the named places, and the goals of the running navigation."""
        running = robot.jobs.running(Navigation) if self.source.is_live else ()
        legs = [leg for job in running for leg in job.legs[job.now :]]
        self.sent_to = {leg.place for leg in legs}
        for leg in legs:
            yaw_rad = None if leg.yaw_deg is None else math.radians(leg.yaw_deg)
            self._mark_in(NamedPlace(leg.place or "navigation", leg.frame, leg.x_m, leg.y_m, yaw_rad), "goal")
        try:
            known = places_of(robot).all()
        except RobotError as error:
            self.missing.append(f"Named places are not shown: {error.message}")
            return
        for one in known[:_MOST_PLACES]:
            self._mark_in(one, "place")

    def _place_zones(self, robot: Robot) -> None:
        """Add the keep-out zones of the policy."""
        import numpy as np  # not at the start of the server

        from ros2_mcp.pictures.scene import Zone

        zones = [one.keep_out for one in robot.policy.documents if one.keep_out]
        for keep_out, pose in [(one, pose) for one in zones if (pose := self._now_in(one.frame_id))]:
            for name, polygon in keep_out.zones.items():
                self.zones.append(Zone(name, np.array([pose.applied((x, y, 0.0))[:2] for x, y in polygon])))
                self.layers.append(SceneLayer("keep-out zone", name))

    def place_way(self, way: Way) -> None:
        """Add the path given by the caller."""
        import numpy as np  # not at the start of the server

        pose = self._now_in(way.frame)
        if pose is None or not way.points:
            return
        points = [pose.applied((x, y, 0.0))[:2] for x, y, *_ in way.points]
        self.paths.append(np.array(points))
        self.path_names.append(way.name)
        x_m, y_m = points[-1]
        self.layers.append(SceneLayer("path", way.name, round(x_m, 3), round(y_m, 3)))
        self._mark("goal", way.name, x_m, y_m, None, None)
        for name, x, y in way.marks:
            self._mark_in(NamedPlace(name, way.frame, x, y, None), "place")

    def _now_in(self, frame: str) -> Pose | None:
        frame = frame.lstrip("/")
        if frame == self.frame:
            return Pose()
        found = self.tree.newest(self.frame, frame)
        return found.pose if found else None

    def _mark_in(self, place: NamedPlace, kind: str) -> None:
        if pose := self._now_in(place.frame):
            x_m, y_m, _ = pose.applied((place.x_m, place.y_m, 0.0))
            yaw_rad = None if place.yaw_rad is None else place.yaw_rad + pose.yaw_rad
            self._mark(kind, place.name, x_m, y_m, yaw_rad, None)

    def _mark(self, kind: str, name: str, x_m: float, y_m: float, yaw_rad: float | None, age_s: float | None) -> None:
        from ros2_mcp.pictures.scene import Mark

        marks = self.goals if kind == "goal" else self.places
        if kind == "goal":
            marks.append(Mark(f"goal {name}" if name in self.sent_to else "goal", x_m, y_m, yaw_rad))
        elif name not in self.sent_to:  # otherwise one label would hide the other
            marks.append(Mark(name, x_m, y_m, yaw_rad))
        yaw_deg = None if yaw_rad is None else round(math.degrees(yaw_rad), 1)
        self.layers.append(SceneLayer(kind, name, round(x_m, 3), round(y_m, 3), yaw_deg, age_s))


_PLACERS: dict[str, Callable[[Gathered, str, Any, Pose, float | None], None]] = {
    "scan": Gathered.place_scan,
    "path": Gathered.place_path,
    "goal": Gathered.place_goal,
    "footprint": Gathered.place_footprint,
}


async def _picture(gathered: Gathered, request: SceneRequest) -> ScenePicture:
    source, at = gathered.source, gathered.robot
    if request.radius_m is not None and at is None:
        raise BadInput(f"The robot's pose in {named(gathered.frame)} is unknown, so its surroundings cannot be shown.")
    try:
        drawing, scene, picture = await asyncio.to_thread(_drawn, gathered, request)
    except BadData as error:  # there is nothing to show
        if absence := await source.absence():
            raise NotFound(absence, "ros2_status shows domain and middleware.") from error
        raise
    first_scan = next(((name, found) for kind, name, found in gathered.read_layers if kind == "scan"), None)
    meaning = None
    if first_scan:
        name, found = first_scan
        meaning = await meaning_of(source, name, LASER_SCAN, found.message, found.sample.received_ns)
        gathered.tell_age(name, found)
    smaller = picture.width / drawing.raster.pixels.shape[1]
    now_ns = gathered.at_ns
    age_s = since_s(at.stamp_ns if at else None, now_ns)
    if age_s is not None and age_s > _OLD_S:
        gathered.missing.append(f"The robot's pose is {age_s:.1f} s old.")
    return ScenePicture(
        frame_id=gathered.frame,
        x_min_m=round(scene.x.low, 4),
        x_max_m=round(scene.x.high, 4),
        y_min_m=round(scene.y.low, 4),
        y_max_m=round(scene.y.high, 4),
        grid_spacing_m=drawing.line_m,
        metres_per_pixel=drawing.metres_per_pixel / smaller,
        left_px=round(drawing.left_px * smaller),
        top_px=round(drawing.top_px * smaller),
        robot_x_m=at and round(at.x_m, 3),
        robot_y_m=at and round(at.y_m, 3),
        robot_z_m=at and round(at.z_m, 3),
        robot_yaw_deg=at and round(math.degrees(at.yaw_rad), 1),
        robot_age_s=age_s,
        layers=gathered.layers,
        meaning=meaning,
        missing=gathered.missing,
        at=iso_time(now_ns) if source.is_live else recorded_time(now_ns, source.began_ns),
        seconds_from_start=seconds_from_start(now_ns, source.began_ns),
        source=source.title,
        pictures=facts([picture]),
        images=[picture],
    )


def _drawn(gathered: Gathered, request: SceneRequest) -> tuple[SceneDrawing, Scene, Picture]:
    import numpy as np  # not at the start of the server

    from ros2_mcp.pictures.raster import finished
    from ros2_mcp.pictures.scene import Scene, extent, scene_drawing

    points = [*gathered.scans, *gathered.paths]  # without places, which may lie in another building
    points += [np.array([[mark.x_m, mark.y_m]]) for mark in gathered.goals]
    points += [np.array(seen) for limb in gathered.limbs if (seen := [*limb.outline, *(limb.bone or ())])]
    x, y = extent(gathered.grid_layer, points, gathered.robot, request.radius_m)
    scene = Scene(
        frame=gathered.frame,
        x=x,
        y=y,
        grid=gathered.grid_layer,
        robot=gathered.robot,
        footprint=gathered.footprint,
        limbs=gathered.limbs,
        scans=gathered.scans,
        paths=gathered.paths,
        path_names=gathered.path_names,
        goals=gathered.goals,
        places=gathered.places,
        zones=gathered.zones,
    )
    drawing = scene_drawing(scene, BOUNDS)
    return drawing, scene, finished(drawing.raster, BOUNDS)


# ── small ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _chosen_grid(asked: str, grids: Sequence[str]) -> str:
    """Return the topic of the grid: the requested topic, else a map, else a costmap; empty if there is no such topic.

    Raises:
        NotFound: if `costmap` is requested and none is published.
    """
    costmaps = [name for name in grids if _COSTMAP in name]
    maps = [name for name in grids if _COSTMAP not in name]
    if asked.strip() == _COSTMAP:
        if not costmaps:
            raise NotFound("No costmap has a publisher.", f"Grids are: {listed(grids, 8) or 'none'}.")
        return next((name for name in costmaps if "global" in name), costmaps[0])
    if asked.strip():
        return names.absolute(asked)
    return next((name for name in maps if name.rpartition("/")[2] == "map"), (maps or costmaps or [""])[0])


async def _next(source: Source, topic: str, type_name: str, wait_s: float) -> Next | RobotError:
    try:
        return await next_message(source.lasting(wait_s), topic, type_name, silent)
    except RobotError as error:
        return error


def _place(pose: Pose) -> Place:
    return Place(pose.translation[0], pose.translation[1], pose.yaw_rad)
