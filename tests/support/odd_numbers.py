"""Messages of a robot whose numbers are not finite, for tests on a recording and on a real node.

Each topic has its type and what is set in it; all else is as nobody has filled it in.
"""

from __future__ import annotations

import math
from typing import Any

NAN, INF = math.nan, math.inf
_AT_NAN = {"position": {"x": NAN, "y": 1.0}, "orientation": {"w": 1.0}}
_AT_INF = {"position": {"x": 1.0, "y": INF}, "orientation": {"w": 1.0}}
_TURNED_NAN = {"position": {"x": 1.0}, "orientation": {"z": NAN, "w": 1.0}}
_NOT_TURNED = {"position": {"x": 1.0}, "orientation": {"w": 0.0}}
_MAP, _BASE = {"frame_id": "map"}, {"frame_id": "base_link"}


def _grid(resolution: float = 0.1, origin: Any = None, cells: int = 16) -> tuple[str, dict[str, Any]]:
    info = {"width": 4, "height": 4, "resolution": resolution, "origin": origin or {"orientation": {"w": 1.0}}}
    return "nav_msgs/msg/OccupancyGrid", {"header": _MAP, "info": info, "data": [0] * cells}


def _scan(**fields: Any) -> tuple[str, dict[str, Any]]:
    usual = {"angle_min": -1.5, "angle_max": 1.5, "angle_increment": 0.1, "range_min": 0.1, "range_max": 10.0}
    return "sensor_msgs/msg/LaserScan", {"header": {"frame_id": "laser"}, "ranges": [2.0] * 31, **usual, **fields}


def _edge(parent: str, child: str, **transform: Any) -> dict[str, Any]:
    whole = {"rotation": {"w": 1.0}, **transform}
    return {"header": {"frame_id": parent}, "child_frame_id": child, "transform": whole}


def _cloud(*points: tuple[float, float, float]) -> tuple[str, dict[str, Any]]:
    import struct

    data = list(b"".join(struct.pack("<3f", *point) for point in points))
    fields = [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate("xyz")]
    size = {"width": len(points), "height": 1, "point_step": 12, "row_step": 12 * len(points)}
    return "sensor_msgs/msg/PointCloud2", {"header": _BASE, **size, "fields": fields, "data": data}


def _odometry(pose: Any, twist: Any) -> tuple[str, dict[str, Any]]:
    header = {"frame_id": "odom"}
    return "nav_msgs/msg/Odometry", {
        "header": header,
        "child_frame_id": "base_link",
        "pose": {"pose": pose},
        "twist": {"twist": twist},
    }


def _image() -> tuple[str, dict[str, Any]]:
    import struct

    data = list(struct.pack("<16f", *([NAN] * 8 + [INF] * 8)))
    size = {"width": 4, "height": 4, "encoding": "32FC1", "step": 16}
    return "sensor_msgs/msg/Image", {"header": _BASE, **size, "data": data}


def _frames(*edges: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    return "tf2_msgs/msg/TFMessage", {"transforms": list(edges)}


BROKEN_FRAMES = _frames(
    _edge("map", "odom", translation={"x": NAN}),
    _edge("odom", "base_link", rotation={"w": 0.0}),
    _edge("base_link", "laser", rotation={"z": NAN, "w": 1.0}),
    _edge("base_link", "camera", translation={"y": INF}),
    _edge("base_link", "arm"),
)
FRAMES = _frames(
    _edge("map", "odom"), _edge("odom", "base_link"), _edge("base_link", "laser"), _edge("base_link", "arm")
)
"""What `/tf` tells instead where all that is drawn is to have its place."""
URDF = """<robot name="odd">
<link name="base_link"><collision><geometry><cylinder radius="nan" length="0.2"/></geometry></collision></link>
<link name="laser"/><link name="arm"/><link name="wheel"/>
<joint name="mount" type="fixed"><parent link="base_link"/><child link="laser"/><origin xyz="nan 0 0" rpy="0 inf 0"/>
</joint>
<joint name="shoulder" type="revolute"><parent link="base_link"/><child link="arm"/><axis xyz="nan 0 1"/>
<limit lower="nan" upper="inf" velocity="nan" effort="1"/></joint>
<joint name="wheel_joint" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
</robot>"""

MESSAGES: dict[str, tuple[str, dict[str, Any]]] = {
    "/map": _grid(origin=_AT_NAN),
    "/map_turned": _grid(origin=_TURNED_NAN),
    "/map_not_turned": _grid(origin=_NOT_TURNED),
    "/map_far": _grid(origin={"position": {"x": 1e300}, "orientation": {"w": 1.0}}),
    "/map_zero": _grid(0.0),
    "/map_negative": _grid(-0.05),
    "/map_nan": _grid(NAN),
    "/map_inf": _grid(INF),
    "/map_short": _grid(cells=3),
    "/global_costmap/costmap": _grid(origin=_AT_INF),
    "/local_costmap/costmap": _grid(NAN),
    "/local_costmap/published_footprint": (
        "geometry_msgs/msg/PolygonStamped",
        {"header": _BASE, "polygon": {"points": [{"x": NAN}, {"x": 0.3, "y": INF}, {"x": -0.3, "y": 0.2}, {"y": 1.0}]}},
    ),
    "/odom": _odometry(_AT_NAN, {"linear": {"x": 0.1}}),
    "/odom_inf": _odometry(_AT_INF, {"linear": {"x": INF}}),
    "/odom_turned": _odometry(_TURNED_NAN, {"angular": {"z": NAN}}),
    "/odom_not_turned": _odometry(_NOT_TURNED, {}),
    "/tf": BROKEN_FRAMES,
    "/battery_state": (
        "sensor_msgs/msg/BatteryState",
        {"percentage": NAN, "voltage": NAN, "current": INF, "cell_voltage": [NAN]},
    ),
    "/battery_inf": ("sensor_msgs/msg/BatteryState", {"percentage": INF}),
    "/scan": _scan(range_min=NAN, range_max=NAN),
    "/scan_angle": _scan(angle_min=NAN),
    "/scan_step": _scan(angle_increment=0.0),
    "/scan_step_nan": _scan(angle_increment=NAN),
    "/scan_wide": _scan(angle_max=NAN, range_max=INF),
    "/scan_ranges": _scan(ranges=[NAN] * 31),
    "/scan_far": _scan(ranges=[INF] * 31, range_max=INF),
    "/joint_states": (
        "sensor_msgs/msg/JointState",
        {"name": ["shoulder", "wheel_joint"], "position": [NAN, INF], "velocity": [NAN, NAN], "effort": [INF]},
    ),
    "/plan": (
        "nav_msgs/msg/Path",
        {"header": _MAP, "poses": [{"pose": _AT_NAN}, {"pose": _AT_INF}, {"pose": _TURNED_NAN}]},
    ),
    "/goal_pose": ("geometry_msgs/msg/PoseStamped", {"header": _MAP, "pose": _TURNED_NAN}),
    "/amcl_pose": (
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        {"header": _MAP, "pose": {"pose": _AT_NAN, "covariance": [NAN] * 36}},
    ),
    "/pose": (
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        {"header": _MAP, "pose": {"pose": _TURNED_NAN, "covariance": [INF] * 36}},
    ),
    "/cloud": _cloud((NAN, NAN, NAN), (INF, 0.0, 0.0)),
    "/cloud_far": _cloud((1.0, 2.0, 3.0), (3e38, -3e38, 3e38)),
    "/imu": (
        "sensor_msgs/msg/Imu",
        {"orientation": {"w": NAN}, "angular_velocity": {"z": INF}, "linear_acceleration": {"x": NAN}},
    ),
    "/gps": (
        "sensor_msgs/msg/NavSatFix",
        {"latitude": NAN, "longitude": INF, "altitude": NAN, "position_covariance": [NAN] * 9},
    ),
    "/sonar": ("sensor_msgs/msg/Range", {"min_range": NAN, "max_range": INF, "field_of_view": NAN, "range": NAN}),
    "/depth": _image(),
    "/camera_info": ("sensor_msgs/msg/CameraInfo", {"width": 4, "height": 4, "k": [INF, *[NAN] * 8]}),
    "/speed": ("std_msgs/msg/Float32", {"data": NAN}),
    "/height": ("std_msgs/msg/Float64", {"data": INF}),
    "/temperature": ("sensor_msgs/msg/Temperature", {"temperature": NAN, "variance": INF}),
    "/force": ("geometry_msgs/msg/WrenchStamped", {"wrench": {"force": {"x": NAN}}}),
    "/marker": (
        "visualization_msgs/msg/Marker",
        {"header": _BASE, "type": 1, "pose": _AT_NAN, "scale": {"x": NAN, "y": 1.0}, "color": {"a": NAN}},
    ),
    "/list": ("std_msgs/msg/Float64MultiArray", {"data": [NAN, INF, -INF, 1.0] * 20}),
    "/robot_description": ("std_msgs/msg/String", {"data": URDF}),
    "/diagnostics": (
        "diagnostic_msgs/msg/DiagnosticArray",
        {"status": [{"name": "motor", "level": 1, "message": "warm", "values": [{"key": "current", "value": "nan"}]}]},
    ),
}
"""By topic: its type, and what is set in it."""
