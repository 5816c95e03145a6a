"""A healthy server that is busy keeps its link lease, for 20 minutes (ROS2_MCP_BUSY_S).

And whatever takes it long, once or again and again, leaves it no silence that is near the lease.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import time
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from support.agent import until
from support.driver import MOVING, Driver, fresh
from support.observer import Observer, observing
from support.processes import peer_command
from support.velocities import TWIST, speed

BUSY_S = float(os.environ.get("ROS2_MCP_BUSY_S", "1200"))
CALLS = 200
PICTURE_BYTES, PICTURES_HZ = 900_000, 30.0
"""27 MB/s: a colour camera of 640 x 480."""
HZ = 20.0
REPEAT_S = 600.0
SET_BOOL = "std_srvs/srv/SetBool"


pytestmark = pytest.mark.full
"""How soon it is the turn of a process is the machine's affair. In CI, tests/unit/model/test_aside.py holds that large
work leaves the event loop free, and tests/unit/link/test_connection.py that a request follows a ping with its lease.
"""


class Load:
    """So many calls under way, a subscription to the pictures, and the repeat: each is begun again when it ends."""

    def __init__(self, server: Driver, service: str, pictures: str, topic: str) -> None:
        self.server, self.service, self.pictures, self.topic = server, service, pictures, topic
        self.calls = deque(self._call() for _ in range(CALLS))
        self.reading, self.repeating = self._read(), self._repeat()
        self.answered = self.repeats = 0
        self.faults: list[str] = []

    def go_on(self) -> None:
        """Take one answer, and ask again."""
        said = self.server.outcome(self.calls.popleft())
        if '"called": true' not in said:
            self.faults.append(said)
        self.answered += 1
        self.calls.append(self._call())
        if self.reading in self.server.answers:
            self.server.outcome(self.reading)
            self.reading = self._read()
        if self.repeating in self.server.answers:
            self.faults += [
                said for said in [self.server.outcome(self.repeating)] if "lease" in said or '"isError": true' in said
            ]
            self.repeating, self.repeats = self._repeat(), self.repeats + 1

    def _call(self) -> int:
        asked = {"service_name": self.service, "service_type": SET_BOOL, "fields": {"data": True}}
        return self.server.tool("ros2_service_call", **asked, timeout_sec=30)

    def _read(self) -> int:
        return self.server.tool("ros2_topic_subscribe", topic_name=self.pictures, duration=5, message_limit=1000)

    def _repeat(self) -> int:
        timed = {"frequency": HZ, "duration": min(REPEAT_S, BUSY_S + 60)}
        return self.server.tool(
            "ros2_topic_publish", topic_name=self.topic, message_type=TWIST, data=speed(TWIST, MOVING), **timed
        )


@pytest.mark.timeout(BUSY_S + 150)
def test_a_busy_server_keeps_its_lease(start_server, observer, ros_environment) -> None:
    server, service, pictures, topic = start_server(), fresh("serves"), fresh("camera"), fresh("steady")
    with observing(ros_environment) as camera:
        camera.pictures(topic=pictures, size=PICTURE_BYTES, hz=PICTURES_HZ)
        camera.serve(service=service, kind=SET_BOOL, delay_s=0.05)
        observer.join(by=topic, topic=topic, kind=TWIST)
        server.knows(topic, 1)
        until(lambda: service in str(server.do("ros2_service_list")))
        load, began = Load(server, service, pictures, topic), time.monotonic()
        observer.until_driven(topic)
        longest_s, zeros = 0.0, 0
        while (passed := time.monotonic() - began) < BUSY_S:
            looked = time.monotonic() + 5.0
            while time.monotonic() < looked:
                load.go_on()
            heard = observer.messages(topic=topic)
            sent = [one["sent"] for one in heard]
            longest_s = max([longest_s, *((b - a) / 1e9 for a, b in pairwise(sent))])
            zeros += sum(not any(one["values"]) for one in heard)
            observer.forget()
            if int(passed) % 60 < 5:
                print(
                    f"{passed:.0f} s, {load.answered} calls, longest gap {longest_s:.3f} s, {zeros} zeros", flush=True
                )
        status = server.do("ros2_status")
        server.stop()
    print(f"{load.answered} calls, {load.repeats} repeats ended, longest gap {longest_s:.3f} s, {zeros} zeros")
    assert load.faults == []
    assert zeros <= 2 * load.repeats, "a zero of a lease that lapsed"
    assert "lapsed" not in json.dumps(status)
    server.errors.seek(0)
    assert b"lapsed" not in server.errors.read()


SILENT_S = 0.75
"""A quarter of the lease is left: the server pings every 0.25 s, and nothing holds it up for twice as long."""
POSES = 100_000
POSE_ARRAY = "geometry_msgs/msg/PoseArray"


class Large:
    """What takes a server long: each is asked for twice, the first time with what has to be imported for it."""

    def __init__(self, server: Driver, observer: Observer) -> None:
        self.server, self.observer = server, observer
        self.poses, self.cloud, self.map = fresh("poses"), fresh("cloud"), fresh("map")

    def publish(self) -> None:
        """100,000 poses as an agent would write them: 3 MB of JSON, 5.6 MB for the robot."""
        poses = {"poses": [{"position": {"x": 0.5}}] * POSES}
        self.server.do("ros2_topic_publish", topic_name=fresh("many"), message_type=POSE_ARRAY, data=poses)

    def pictures(self) -> None:
        cloud = self.server.tool("ros2_get_pointcloud_as_bev", topic_name=self.cloud)
        grid = self.server.tool("ros2_get_map_as_image", topic_name=self.map)
        assert self.server.result(cloud)["points"] and self.server.result(grid)["width"] == 1000

    def watch(self) -> None:
        """A client that looks at a topic whenever something comes."""
        for _ in range(3):
            read = self.server.ask("resources/read", uri=f"ros2://topic{self.poses}")
            assert "result" in read, read

    def relay(self) -> None:
        """Compares every message with the one before."""
        to = fresh("changed")
        asked = {"source_topic": self.poses, "destination_topic": to, "transform": "on_change", "duration_sec": 3}
        relay = self.server.do("ros2_relay_start", **asked)["relay_id"]

        def state() -> dict[str, object]:
            relays = self.server.do("ros2_relay_list")["relays"]
            return next(one for one in relays if one["relay_id"] == relay)

        until(lambda: state()["state"] == "ended")
        assert state()["published"], state()


@pytest.fixture
def silences(tmp_path: Path) -> Path:
    """Where it is noted for how long a server was silent whose `--bridge-python` is the program beside it."""
    python, noted = tmp_path / "python", tmp_path / "silences"
    command = [*peer_command("silence_peer"), str(noted), sys.executable]
    python.write_text(f'#!/bin/sh\nexec {shlex.join(command)} "$@"\n')
    python.chmod(0o755)
    noted.touch()
    return noted


@pytest.mark.alone
@pytest.mark.timeout(150)
def test_nothing_large_makes_a_server_silent_for_long(start_server, observer, silences) -> None:
    server = start_server("--tools", "all", "--bridge-python", str(silences.with_name("python")))
    large, topic = Large(server, observer), fresh("steady")
    observer.large(poses=large.poses, cloud=large.cloud, grid=large.map, hz=5.0)
    observer.join(by=topic, topic=topic, kind=TWIST)
    server.knows(topic, 1)
    timed = {"frequency": HZ, "duration": 120}
    driving = server.tool(
        "ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, MOVING), **timed
    )
    observer.until_driven(topic)
    longest: dict[str, float] = {}
    work: list[Callable[[], None]] = [large.publish, large.pictures, large.watch, large.relay]
    for one in work * 2:
        before = len(silences.read_text().splitlines())
        one()
        told = silences.read_text().splitlines()[before:]
        longest[one.__name__] = max([longest.get(one.__name__, 0.0), *(float(line.split()[1]) for line in told)])
    print("silent for at most", longest)
    assert driving not in server.answers, server.outcome(driving)
    assert not [one for one in observer.messages(topic=topic) if not any(one["values"])], "a zero of a lapsed lease"
    assert max(longest.values()) < SILENT_S, longest
    server.stop()
