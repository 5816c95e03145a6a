"""A recording of a small robot with a hole in its middle, of every kind that disks and killed recorders make."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from support.made_windows import encoded

START_NS = 1_700_000_000_000_000_000
LENGTH_S = 40
RATE_HZ = 20
"""Of every topic but the map, so that a chunk of a second has some of each."""
TYPES = {
    "/odom": "nav_msgs/msg/Odometry",
    "/odom_again": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/cloud": "sensor_msgs/msg/PointCloud2",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/rosout": "rcl_interfaces/msg/Log",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


def messages() -> Iterator[tuple[str, int, bytes]]:
    """Topic, time and bytes: the robot drives at 1 m/s, never stops, never jumps."""
    for number in range(LENGTH_S * RATE_HZ):
        at_ns = START_NS + number * 1_000_000_000 // RATE_HZ
        for topic, type_name in TYPES.items():
            yield topic, at_ns, encoded(type_name, _value(topic, number, at_ns))


def _value(topic: str, number: int, at_ns: int) -> dict[str, Any]:
    stamp = {"sec": at_ns // 10**9, "nanosec": at_ns % 10**9}
    header = {"stamp": stamp, "frame_id": "map"}
    if topic.startswith("/odom"):
        return {"header": header, "pose": {"pose": {"position": {"x": number / RATE_HZ}}}}
    if topic == "/imu":
        return {"header": header, "angular_velocity": {"z": number % 7 / 10}}
    if topic == "/cloud":
        fields = [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate("xyz")]
        return {
            "header": header,
            "height": 1,
            "width": 4,
            "fields": fields,
            "point_step": 12,
            "row_step": 48,
            "data": [0, 0, 128, 63] * 12,
        }
    if topic == "/map":
        return {"header": header, "info": {"resolution": 0.1, "width": 2, "height": 2}, "data": [0, 0, 100, -1]}
    if topic == "/rosout":
        return {"stamp": stamp, "level": 20, "name": "driver", "msg": f"line {number}"}
    return {"header": header, "status": [{"name": "motor", "message": "fine"}]}


def whole_mcap(folder: Path) -> Path:
    """The recording, closed, with a chunk for each second; the path of its file."""
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    latched = qos_text([QoS(durability="transient_local")])
    for topic, type_name in TYPES.items():
        writer.add_topic(StoredTopic(topic, type_name, None, "", "", latched if topic == "/map" else ""))
    for number, (topic, at_ns, body) in enumerate(messages(), 1):
        writer.write(topic, Sample(at_ns, at_ns, number, body))
        if number % (RATE_HZ * len(TYPES)) == 0:
            writer.flush()
    writer.close()
    return writer.path


def with_damaged_chunk(folder: Path) -> None:
    """The index is whole; of one chunk in the middle the checksum is wrong."""
    path = whole_mcap(folder)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    path.write_bytes(whole)


def with_missing_end(folder: Path) -> None:
    """The file is cut, as by a full disk, and has a hole before that."""
    path = whole_mcap(folder)
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + b"\xff" * 100 + whole[middle + 100 : len(whole) * 3 // 4])


def with_damaged_page(folder: Path) -> None:
    """A database in which pages in the middle are zeros."""
    folder.mkdir()
    path = folder / f"{folder.name}_0.db3"
    connection = sqlite3.connect(path)
    connection.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, "
        "offered_qos_profiles TEXT)"
    )
    connection.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB NOT NULL)"
    )
    connection.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    numbers = {topic: number for number, topic in enumerate(TYPES, 1)}
    for topic, number in numbers.items():
        connection.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')", (number, topic, TYPES[topic]))
    rows = [(numbers[topic], at_ns, body) for topic, at_ns, body in messages()]
    connection.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    connection.commit()
    connection.close()
    whole = bytearray(path.read_bytes())
    middle = len(whole) // 2 // 4096 * 4096
    whole[middle : middle + 32 * 4096] = bytes(32 * 4096)  # a second and a half of messages
    path.write_bytes(whole)


KINDS = {"chunk": with_damaged_chunk, "cut": with_missing_end, "page": with_damaged_page}


def with_undecodable_messages(folder: Path) -> int:
    """A whole bag in which one message of each topic is not what its type says; the time of these."""
    bad_ns = START_NS + 20 * 1_000_000_000
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    for topic, type_name in TYPES.items():
        writer.add_topic(StoredTopic(topic, type_name, None, "", "", ""))
    for number, (topic, at_ns, body) in enumerate(messages(), 1):
        writer.write(topic, Sample(at_ns, at_ns, number, b"\0\1\0\0\xff\xff" if at_ns == bad_ns else body))
    writer.close()
    return bad_ns
