"""A bag whose every text is hostile: values, names of topics and types, definitions, frames, formats, metadata."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from PIL import Image
from rosbags.typesys import Stores, get_typestore

from support.hidden import HIDDEN
from support.outlets import FORGED, hostile

SECOND_NS = 10**9
BEGINNING_NS = 1_700_000_000 * SECOND_NS
STRING, FLOAT = "std_msgs/msg/String", "std_msgs/msg/Float64"
TOPICS = ("/text", "/number", "/rosout", "/diagnostics", "/image", "/jpeg", "/no_jpeg", "/cloud", "/no_cloud", "/map")
ODD_TOPICS = ("/joints", "/odd_type", "/odd_definition", "/two_types")
_STORE = get_typestore(Stores.ROS2_HUMBLE)
_ODD = f"string text  # {hostile()}\nstring CONSTANT='{hostile('tags')}'\n{FORGED} {hostile('direction marks')}\n"


def write_hostile_bag(folder: Path) -> Path:
    """The bag as a folder, with metadata that cannot be read."""
    folder.mkdir()
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {{{hostile('tags')}", encoding="utf-8")
    with (folder / "hostile_0.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library=hostile())
        _write(writer)
        writer.finish()
    return folder


def _write(writer: Writer) -> None:
    bag = _Bag(writer)
    for number, what in enumerate(HIDDEN):
        bag.add("/text", STRING, number, data=hostile(what))
        bag.add("/number", FLOAT, number, data=float(number))
        bag.add(f"/hostile name\n{FORGED}{HIDDEN[what]}", FLOAT, number, data=1.0)
    stamp, frame = _made("builtin_interfaces/msg/Time", sec=1, nanosec=0), hostile("overrides of direction")
    header = _made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)
    said = {"name": hostile(), "msg": hostile(), "file": hostile(), "function": hostile()}
    bag.add("/rosout", "rcl_interfaces/msg/Log", 0, stamp=stamp, level=40, line=1, **said)
    values = [_made("diagnostic_msgs/msg/KeyValue", key=hostile("tags"), value=hostile("tags"))]
    words = {"name": hostile("soft hyphen"), "message": hostile("tags"), "hardware_id": hostile("tags")}
    status = _made("diagnostic_msgs/msg/DiagnosticStatus", level=2, values=values, **words)
    bag.add("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 0, header=header, status=[status])
    _add_pictures(bag, header)
    joints = {name: np.zeros(1) for name in ("position", "velocity", "effort")}
    bag.add("/joints", "sensor_msgs/msg/JointState", 0, header=header, name=[hostile()], **joints)
    bag.add_raw("/odd_type", f"odd_msgs/msg/{hostile('zero width space')}", "string data\n", b"\0\1\0\0")
    bag.add_raw("/odd_definition", "odd_msgs/msg/Odd", _ODD, b"\0\1\0\0\1\0\0\0\0")
    bag.add("/two_types", STRING, 0, data=hostile())
    bag.add_raw("/two_types", f"odd_msgs/msg/Other{hostile('tags')}", "string data\n", b"\0\1\0\0")


def _add_pictures(bag: _Bag, header: Any) -> None:
    grey = {"height": 4, "width": 4, "is_bigendian": 0, "step": 4, "data": np.zeros(16, np.uint8)}
    bag.add("/image", "sensor_msgs/msg/Image", 0, header=header, encoding=hostile("tags"), **grey)
    jpeg = io.BytesIO()
    Image.new("RGB", (8, 8)).save(jpeg, "JPEG")
    for topic, data in (("/jpeg", jpeg.getvalue()), ("/no_jpeg", b"no picture")):
        pixels = np.frombuffer(data, np.uint8)
        bag.add(topic, "sensor_msgs/msg/CompressedImage", 0, header=header, format=hostile("tags"), data=pixels)
    for topic, names in (("/cloud", "xyz"), ("/no_cloud", "ab")):
        fields = [
            _made("sensor_msgs/msg/PointField", name=name, offset=4 * place, datatype=7, count=1)
            for place, name in enumerate([*names, hostile("tags")])
        ]
        size = 4 * len(fields)
        shape = {"height": 1, "width": 2, "is_bigendian": False, "point_step": size, "row_step": 2 * size}
        points = np.zeros(2 * size, np.uint8)
        cloud = "sensor_msgs/msg/PointCloud2"
        bag.add(topic, cloud, 0, header=header, fields=fields, is_dense=True, data=points, **shape)
    origin = _made(
        "geometry_msgs/msg/Pose",
        position=_made("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
        orientation=_made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    info = {"map_load_time": header.stamp, "resolution": 0.1, "width": 2, "height": 2, "origin": origin}
    meta = _made("nav_msgs/msg/MapMetaData", **info)
    bag.add("/map", "nav_msgs/msg/OccupancyGrid", 0, header=header, info=meta, data=np.zeros(4, np.int8))


def _made(kind: str, **fields: Any) -> Any:
    return _STORE.types[kind](**fields)


class _Bag:
    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}

    def add(self, topic: str, kind: str, number: int, **fields: Any) -> None:
        definition, _ = _STORE.generate_msgdef(kind, ros_version=2)
        self.add_raw(topic, kind, definition, bytes(_STORE.serialize_cdr(_made(kind, **fields), kind)), number)

    def add_raw(self, topic: str, kind: str, definition: str, data: bytes, number: int = 0) -> None:
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition.encode())
        if (topic, kind) not in self._channels:
            named = {"topic": topic, "message_encoding": "cdr", "schema_id": self._schemas[kind]}
            self._channels[topic, kind] = self._writer.register_channel(**named)
        at_ns = BEGINNING_NS + number * SECOND_NS // 10
        self._writer.add_message(self._channels[topic, kind], log_time=at_ns, publish_time=at_ns, data=data)
