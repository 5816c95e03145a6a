"""Reading large recordings, beside rosbags and NumPy over the same topics; and how it grows with the size of the bag.

`python -m bench.bags FOLDER` adds the points of growth to those in the docs; it needs room for 20 GB there.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from . import slowed
from .growth import keep
from .processes import ENVIRONMENT, ours
from .report import Row, p50, table

GB = 10**9
SIZES_GB = (0.1, 1, 5, 20)
BEGAN_NS = 1_700_000_000 * 10**9
PATTERN_S = 20
"""Period after which the values repeat; only the stamps are new."""
PICTURE_BYTES, CAMERA_HZ = 100_000, 30
CHUNK_BYTES = 786_432
"""Chunks as rosbag2's MCAP storage writes them: uncompressed, each with its CRC."""
TOPICS = ["/imu", "/odom", "/scan"]
CONDITION = "linear_acceleration.z > 100"

FLOOR = """
import sys, time
from pathlib import Path
import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

def numbers(of):
    p = lambda v: (v.x, v.y, v.z)
    q = lambda v: (v.x, v.y, v.z, v.w)
    if of == "/imu":
        return lambda m: (*q(m.orientation), *p(m.angular_velocity), *p(m.linear_acceleration)), lambda m: (
            m.orientation_covariance, m.angular_velocity_covariance, m.linear_acceleration_covariance)
    if of == "/odom":
        return lambda m: (*p(m.pose.pose.position), *q(m.pose.pose.orientation), *p(m.twist.twist.linear),
            *p(m.twist.twist.angular)), lambda m: (m.pose.covariance, m.twist.covariance)
    return lambda m: (m.angle_min, m.angle_max, m.angle_increment, m.time_increment, m.scan_time, m.range_min,
        m.range_max), lambda m: (m.ranges, m.intensities)

def measured(path, topics):
    store, found = get_typestore(Stores.ROS2_JAZZY), {topic: ([], [], []) for topic in topics}
    of = {topic: numbers(topic) for topic in topics}
    with Reader(path) as reader:
        for connection, at_ns, data in reader.messages([c for c in reader.connections if c.topic in found]):
            message = store.deserialize_cdr(data, connection.msgtype)
            times, singles, lists = found[connection.topic]
            single, several = of[connection.topic]
            times.append(at_ns)
            singles.append(single(message))
            lists.append(np.concatenate(several(message)))
    for times, singles, lists in found.values():
        seconds = (np.array(times) - times[0]) / 1e9
        for values in (np.array(singles), np.array(lists)):
            (values.min(0), values.max(0), values.mean(0), values.std(0), values.argmin(0), values.argmax(0))
        np.polyfit(seconds, np.array(singles), 1)
        np.median(np.diff(seconds))

def plotted(path):
    store, times, values = get_typestore(Stores.ROS2_JAZZY), [], []
    with Reader(path) as reader:
        for connection, at_ns, data in reader.messages([c for c in reader.connections if c.topic == "/odom"]):
            times.append(at_ns)
            values.append(store.deserialize_cdr(data, connection.msgtype).pose.pose.position.x)
    return np.array(times), np.array(values)

def waited(path):
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(path) as reader:
        for connection, at_ns, data in reader.messages([c for c in reader.connections if c.topic == "/imu"]):
            if store.deserialize_cdr(data, connection.msgtype).linear_acceleration.z > 100:
                return at_ns

def opened(path):
    with Reader(path) as reader:
        return reader.message_count

path, what = Path(sys.argv[1]), sys.argv[2]
work = {"statistics": lambda: measured(path, sys.argv[3:]), "plot": lambda: plotted(path), "wait": lambda: waited(path),
    "index": lambda: opened(path)}[what]
started = time.perf_counter()
work()
print(time.perf_counter() - started)
"""


def _pattern() -> Iterator[tuple[str, str, int, Callable[[float], Any]]]:
    """Yield topic, type, rate in Hz, and a function from time in s to the serialized message, for the topics with
    numbers."""
    import numpy as np
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    noise = np.random.default_rng(17)

    def made(name: str, *values: Any) -> Any:
        return types[name](*values)

    def header(frame: str) -> Any:
        return made("std_msgs/msg/Header", made("builtin_interfaces/msg/Time", 0, 0), frame)

    def vector(x: float, y: float, z: float, of: str = "Vector3") -> Any:
        return made(f"geometry_msgs/msg/{of}", x, y, z)

    def turned(yaw: float) -> Any:
        return made("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))

    def imu(at_s: float) -> Any:
        turn, push = vector(0.01, 0.0, math.cos(at_s)), vector(*noise.normal((0, 0, 9.81), 0.05))
        fixed = [np.full(9, value) for value in (0.01, 0.02, 0.03)]
        return made(
            "sensor_msgs/msg/Imu", header("imu_link"), turned(at_s / 3), fixed[0], turn, fixed[1], push, fixed[2]
        )

    def odom(at_s: float) -> Any:
        there = made("geometry_msgs/msg/Pose", vector(math.sin(at_s / 3), at_s, 0.0, "Point"), turned(at_s / 3))
        moving = made("geometry_msgs/msg/Twist", vector(0.5, 0.0, 0.0), vector(0.0, 0.0, math.cos(at_s)))
        pose = made("geometry_msgs/msg/PoseWithCovariance", there, np.zeros(36))
        twist = made("geometry_msgs/msg/TwistWithCovariance", moving, np.zeros(36))
        return made("nav_msgs/msg/Odometry", header("odom"), "base_link", pose, twist)

    def scan(at_s: float) -> Any:
        ranges, bounds = noise.normal(3 + math.sin(at_s), 0.01, 360).astype(np.float32), (-3.14, 3.14, 0.0175)
        return made(
            "sensor_msgs/msg/LaserScan", header("laser"), *bounds, 0.0, 0.1, 0.1, 12.0, ranges, ranges[:0].copy()
        )

    for topic, name, rate, make in (
        ("/imu", "sensor_msgs/msg/Imu", 200, imu),
        ("/odom", "nav_msgs/msg/Odometry", 50, odom),
        ("/scan", "sensor_msgs/msg/LaserScan", 10, scan),
    ):
        yield topic, name, rate, lambda at_s, make=make, name=name: store.serialize_cdr(make(at_s), name)


def write(path: Path, size: float, compression: str = "NONE") -> None:
    """Write a robot's recording of about `size` bytes: IMU, odometry, laser, and a camera that fills most of it."""
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    noise = os.urandom(2 * PICTURE_BYTES)
    head = struct.pack("<4BiII7s1xI5s3xI", 0, 1, 0, 0, 0, 0, 7, b"camera\0", 5, b"jpeg\0", PICTURE_BYTES)
    picture = bytearray(head + noise[:PICTURE_BYTES])
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType[compression])
        writer.start("ros2")
        channels: dict[str, int] = {}
        events: list[tuple[float, str, bytearray]] = []

        def register(topic: str, name: str) -> None:
            text, _ = store.generate_msgdef(name, ros_version=2)
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)

        for topic, name, rate, make in _pattern():
            register(topic, name)
            events += [(at / rate, topic, bytearray(make(at / rate))) for at in range(PATTERN_S * rate)]
        register("/camera/compressed", "sensor_msgs/msg/CompressedImage")
        frames = range(PATTERN_S * CAMERA_HZ)
        events += [(frame / CAMERA_HZ, "/camera/compressed", picture) for frame in frames]
        events.sort(key=lambda event: event[:2])
        written = round_ = 0
        while written < size:
            for at_s, topic, data in events:
                at_ns = BEGAN_NS + round((round_ * PATTERN_S + at_s) * 1e9)
                struct.pack_into("<iI", data, 4, at_ns // 10**9, at_ns % 10**9)
                writer.add_message(channels[topic], at_ns, bytes(data), at_ns)
                written += len(data)
                if written >= size:
                    break
            round_ += 1
        writer.finish()


def forget(path: Path) -> None:
    """Remove a file from the page cache, as if it had not been read for long."""
    with path.open("rb") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def floor_s(bag: Path, *what: str) -> float:
    """Return the time in s that rosbags and NumPy take, without their start."""
    command = slowed.command([sys.executable, "-c", FLOOR, str(bag), *what])
    return float(subprocess.run(command, env=ENVIRONMENT, check=True, capture_output=True, text=True).stdout)


def peak_mb(pid: int) -> float:
    """Return the peak memory of a process in MB."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6


CALLS: dict[str, tuple[str, dict[str, Any]]] = {
    "statistics": ("ros2_topic_statistics", {"topic_names": TOPICS}),
    "plot": ("ros2_plot", {"series": ["/odom:pose.pose.position.x"]}),
    "wait": ("ros2_wait_until", {"topic_name": "/imu", "condition": CONDITION}),
}
LAST = "ros2_bag_read", {"topic_name": "/odom", "message_limit": 100}


async def call_s(folder: Path, bag: Path, *calls: tuple[str, dict[str, Any]]) -> tuple[list[float], float]:
    """Return the time in s of each call in a server that has just been started, and the server's peak memory in MB."""
    found: list[float] = []
    async with ours("--bag-dir", str(folder), "--tools", "all") as client:
        await client.greet()
        for tool, arguments in calls:
            started = time.perf_counter()
            await client.call(tool, bag=bag.name, **arguments)
            found.append(time.perf_counter() - started)
        return found, peak_mb(client.pid)


async def large(full: bool) -> list[Row]:
    """Measure whole topics of a bag of 3 GB (0.5 GB unless `full`), and the last messages of one topic."""
    size_gb = 3 if full else 0.5
    found: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "run.mcap"
        write(bag, size_gb * GB)
        for what, call in CALLS.items():
            (mine,), most_mb = await call_s(Path(folder), bag, call)
            floor = floor_s(bag, what, *(TOPICS if what == "statistics" else ()))
            note = f"at most {most_mb:.0f} MB"
            found.append(Row(f"{what} over {size_gb:g} GB", mine, "s", 1.2, floor, note))
            found.append(Row(f"memory of the server, {what}", most_mb, "MB", 300))
        found += await _last_rows(Path(folder), bag, size_gb)
    return found


async def _last_rows(folder: Path, bag: Path, size_gb: float) -> list[Row]:
    forget(bag)
    (first, *later), _ = await call_s(folder, bag, *[LAST] * 20)
    note = f"rosbags opens it in {floor_s(bag, 'index'):.2f} s"
    return [
        Row(f"last 100 messages of {size_gb:g} GB, the first time", first, "s", 1.0, note=note),
        Row("the same again, p50", p50(later), "ms", 50),
    ]


def main() -> None:
    """Add the growth with the size of a bag to the file with that of topics, nodes and clients."""
    parser = argparse.ArgumentParser(prog="python -m bench.bags", description=__doc__)
    parser.add_argument("folder", type=Path, help="with room for 20 GB")
    parser.add_argument("sizes", nargs="*", type=float, metavar="GB", default=SIZES_GB)
    arguments = parser.parse_args()
    statistics_of_one = ("ros2_topic_statistics", {"topic_names": ["/odom"]})
    for size_gb in arguments.sizes:
        bag = arguments.folder / "growing.mcap"
        write(bag, size_gb * GB)
        rows = asyncio.run(_last_rows(arguments.folder, bag, size_gb))
        (whole_s,), most_mb = asyncio.run(call_s(arguments.folder, bag, statistics_of_one))
        bag.unlink()
        point = {"n": size_gb, "open_ms": rows[0].value * 1000, "last100_ms": rows[1].value}
        point |= {"statistics_ms": whole_s * 1000, "server_mb": most_mb}
        keep("bags", {name: round(value, 2) for name, value in point.items()})
        print(table(rows), whole_s, most_mb)


if __name__ == "__main__":
    main()
