"""The numbers of a large bag are those of another reader (the `mcap` library and `rosbags`), in little memory."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from ros2_mcp.ops.results.results import four_digits
from support.agent import FULL
from support.made_windows import decoded, encoded

BYTES = 3_000_000_000 if FULL else 100_000_000
MOST_MB = 300
ROWS = 1_000_000 if FULL else 10_000
NUMBER = "std_msgs/msg/Float64"
START_NS = 1_700_000_000_000_000_000
TICK_NS = 5_000_000
SILENCE = 400
"""The tick after which nothing comes for a second."""
TYPES = {
    "/camera": "sensor_msgs/msg/Image",
    "/odom": "nav_msgs/msg/Odometry",
    "/odom_again": "nav_msgs/msg/Odometry",
    "/scan": "sensor_msgs/msg/LaserScan",
}
FIELDS = {"/odom": ["pose.pose.position.x", "twist.twist.linear.x"], "/scan": ["ranges"]}
PICTURE = {"height": 480, "width": 640, "encoding": "rgb8", "step": 1920, "data": [0] * 921_600}


def made(path: Path) -> None:
    """Pictures at 29 Hz, odometry at 50 Hz and scans at 10 Hz, as long as it takes to be so large."""
    random = np.random.default_rng(7)
    picture, written, tick = encoded(TYPES["/camera"], PICTURE), 0, 0
    with path.open("wb") as file:
        writer = Writer(file, 1 << 20, CompressionType.NONE)
        writer.start("ros2", "test")
        channels = {
            topic: writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", b""))
            for topic, kind in TYPES.items()
        }
        while written < BYTES:
            at_ns = START_NS + tick * TICK_NS + int(random.integers(0, 1_000_000)) + (tick > SILENCE) * 10**9
            bodies: dict[str, bytes] = {}
            if tick % 7 == 0:
                bodies["/camera"] = picture
            if tick % 4 == 0:
                pose = {"pose": {"position": {"x": tick * 0.001}}}
                value = {"pose": pose, "twist": {"twist": {"linear": {"x": float(random.normal())}}}}
                bodies["/odom"] = bodies["/odom_again"] = encoded(TYPES["/odom"], value)
            if tick % 20 == 0:
                ranges = [float(r) for r in random.uniform(1, 9, 90)] + [float("nan"), float("inf")]
                bodies["/scan"] = encoded(TYPES["/scan"], {"ranges": ranges})
            for topic, body in bodies.items():
                writer.add_message(channels[topic], at_ns, body, at_ns, tick)
                written += len(body)
            tick += 1
        writer.finish()


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("large") / "large.mcap"
    made(path)
    yield path
    path.unlink()


MEASURED = """
import atexit, pathlib, re, runpy, sys
report = pathlib.Path(sys.argv.pop(1))
status = pathlib.Path("/proc/self/status")
atexit.register(lambda: report.write_text(re.search(r"VmHWM:\\s+(\\d+)", status.read_text())[1]))
runpy.run_module("ros2_mcp", run_name="__main__", alter_sys=True)
"""
"""Runs the command line, and writes its peak of memory: the operating system's own count begins with its parent's."""


def called(bag: Path, tool: str, **arguments: Any) -> dict[str, Any]:
    """The answer of the command line, as people use it; fails if the process took too much memory."""
    words = [f"{name}={json.dumps(value)}" for name, value in arguments.items()]
    report = bag.with_suffix(".peak")
    command = [sys.executable, "-c", MEASURED, str(report), "--bag", str(bag), "call", tool, *words, "--json"]
    answer = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
    peak_mb = int(report.read_text()) / 1024
    print(f"{tool}: {peak_mb:.0f} MB")
    assert peak_mb < MOST_MB
    return json.loads(answer.stdout)


@pytest.fixture(scope="module")
def known(large: Path) -> dict[str, Any]:
    """Times, sizes and values of each topic by the other reader, kept as plain arrays."""
    found: dict[str, Any] = {topic: {"times": [], "bytes": 0, "values": []} for topic in TYPES}
    with large.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            topic = found[channel.topic]
            topic["times"].append(message.log_time)
            topic["bytes"] += len(message.data)
            if channel.topic == "/odom":
                topic["values"].append(np.frombuffer(message.data[-8 * (36 + 6) :], "<f8")[0])
                assert len(message.data) % 4 == 0
            elif channel.topic == "/scan":
                topic["values"].append(np.frombuffer(message.data, "<f4", 92, len(message.data) - 4 * 92 - 4))
    return found


def test_two_topics_of_a_million_messages_are_compared_in_little_memory(tmp_path: Path) -> None:
    values = np.random.default_rng(3).normal(size=ROWS).cumsum()
    head, bag = encoded(NUMBER, {"data": 0.0})[:4], tmp_path / "numbers.mcap"
    with bag.open("wb") as file:
        writer = Writer(file, 1 << 20, CompressionType.NONE)
        writer.start("ros2", "test")
        schema = writer.register_schema(NUMBER, "ros2msg", b"")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        for row in range(ROWS):
            for side, channel in enumerate(channels):
                at_ns = START_NS + row * TICK_NS + side * 1000
                writer.add_message(channel, at_ns, head + struct.pack("<d", values[row] + side * 0.1), at_ns, row)
        writer.finish()
    found = called(bag, "ros2_topic_compare", topic1_name="/a", topic2_name="/b")
    assert (found["pairs"], found["fields"][0]["compared"]) == (ROWS, ROWS)
    assert found["fields"][0]["rms_difference"] == pytest.approx(0.1)
    assert found["receive_delay_s"] == pytest.approx(1e-6)


def test_what_the_other_reader_takes_out_of_the_bytes_is_what_was_written() -> None:
    body = encoded(TYPES["/odom"], {"twist": {"twist": {"linear": {"x": 4.5}}}})
    assert np.frombuffer(body[-8 * (36 + 6) :], "<f8")[0] == 4.5
    scan: Any = decoded(TYPES["/scan"], {"ranges": [1.0, 2.0]})
    assert scan.ranges.tolist() == [1.0, 2.0]


@pytest.mark.promise("ros2_topic_stats", "rate, jitter, gaps, bandwidth")
def test_rates_periods_gaps_and_sizes_are_those_of_the_other_reader(large: Path, known: dict[str, Any]) -> None:
    found = called(large, "ros2_topic_stats", topic_names=list(TYPES))
    for topic in found["topics"]:
        times = np.array(known[topic["topic_name"]]["times"], np.int64)
        periods = np.diff(times) / 1e9
        assert topic["count"] == len(times)
        assert topic["rate_hz"] == four_digits((len(times) - 1) / ((times[-1] - times[0]) / 1e9))
        assert topic["mean_size_bytes"] == four_digits(known[topic["topic_name"]]["bytes"] / len(times))
        assert [topic["period_min_s"], topic["period_max_s"]] == [
            round(period, 6) for period in (periods.min(), periods.max())
        ]
        assert topic["jitter_s"] == pytest.approx(periods.std(), abs=1e-6)  # told in microseconds
        assert topic["gaps"] == np.count_nonzero(periods > 3 * np.median(periods)) == 1


def test_statistics_are_those_of_the_other_reader(large: Path, known: dict[str, Any]) -> None:
    found = called(large, "ros2_topic_statistics", topic_names=["/camera", "/odom", "/scan"])
    camera, odom, scan = found["topics"]
    start_ns = min(times[0] for times in (topic["times"] for topic in known.values()))
    for topic in (camera, odom, scan):
        times = np.array(known[topic["topic_name"]]["times"], np.int64)
        assert (topic["count"], topic["received"], topic["dropped"]) == (len(times), len(times), 0)
        periods = np.diff(times) / 1e9
        assert topic["period_median_s"] == round(np.median(periods), 6)
        long = int(np.argmax(periods))
        (gap,) = topic["gaps"]
        assert gap.startswith(f"nothing for {periods[long]:.3f} s from {(times[long] - start_ns) / 1e9:.3f} s (")
        assert "did not fit" not in topic.get("note", "")
    speed = next(field for field in odom["fields"] if field["field"] == "twist.twist.linear.x")
    values = np.array(known["/odom"]["values"])
    times_s = (np.array(known["/odom"]["times"]) - start_ns) / 1e9
    assert (speed["count"], speed["min"], speed["max"]) == (len(values), values.min(), values.max())
    assert [speed["first"], speed["last"]] == [values[0], values[-1]]
    assert [speed["mean"], speed["std"]] == pytest.approx([values.mean(), values.std()], rel=1e-9)
    assert speed["slope"] == pytest.approx(np.polyfit(times_s, values, 1)[0], rel=1e-6, abs=1e-12)
    ranges = next(field for field in scan["fields"] if field["field"] == "ranges")
    values = np.concatenate(known["/scan"]["values"]).astype(np.float64)
    finite = values[np.isfinite(values)]
    assert (ranges["count"], ranges["not_finite"]) == (len(finite), len(values) - len(finite))
    assert [ranges["min"], ranges["max"]] == [finite.min(), finite.max()]
    assert [ranges["mean"], ranges["std"]] == pytest.approx([finite.mean(), finite.std()], rel=1e-9)


@pytest.mark.timeout(600)  # five programs that each read all of it, 20 s each where eight others use the machine
def test_comparing_checking_plotting_and_waiting_look_at_all_of_it(large: Path, known: dict[str, Any]) -> None:
    count = len(known["/odom"]["times"])
    same = called(large, "ros2_topic_compare", topic1_name="/odom", topic2_name="/odom_again")
    assert (same["verdict"], same["pairs"], same["equal_messages"]) == ("IDENTICAL", count, count)
    health = called(large, "ros2_health_check")
    rates = {name: float(said.split()[1]) for name, said in health["other_topics"].items() if said.startswith("OK, ")}
    rates |= {row["topic_name"]: row["rate_hz"] for row in health["topics"]}
    times = known["/camera"]["times"]
    assert rates["/camera"] == four_digits((len(times) - 1) / ((times[-1] - times[0]) / 1e9))
    plot = called(large, "ros2_plot", series=["/odom:pose.pose.position.x"])
    assert [series["count"] for series in plot["series"]] == [count]
    never = called(large, "ros2_wait_until", topic_name="/odom", condition="pose.pose.position.x > 1e9")
    assert (never["met"], never["messages_checked"]) == (False, count)
    part = called(large, "ros2_topic_subscribe", topic_name="/camera", duration=3600)
    assert part["received"] == len(known["/camera"]["times"])
    assert part["dropped"] == 0 or "did not fit in memory" in part.get("note", "")
