"""A healthy server that is busy keeps its link lease: 10 s here, 20 minutes in full (ROS2_MCP_BUSY_S)."""

from __future__ import annotations

import json
import os
import time
from collections import deque
from itertools import pairwise

import pytest

from support.agent import FULL, until
from support.driver import MOVING, Driver, fresh
from support.observer import observing
from support.velocities import TWIST, speed

BUSY_S = float(os.environ.get("ROS2_MCP_BUSY_S", "1200" if FULL else "10"))
CALLS = 200
PICTURE_BYTES, PICTURES_HZ = 900_000, 30.0
"""27 MB/s: a colour camera of 640 x 480."""
HZ = 20.0
REPEAT_S = 600.0
SET_BOOL = "std_srvs/srv/SetBool"


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
