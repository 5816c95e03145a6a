"""What the page costs, and how soon it stops, shows and forgets: the bars of the live scene, on a quiet machine.

ROS2_MCP_FULL=1 .venv/bin/python -m pytest -n0 -s --timeout 1800 tests/ros/view/test_measures.py
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp.guard.servers import servers_in
from support.agent import Agent, agent_for, until
from support.browser import CHROMIUM, Page, browsing
from support.demo_robot import build_interfaces, with_interfaces
from support.observer import Observer
from support.processes import peer_command, running
from support.room_bag import room_bag
from support.viewing import STOP, text

pytestmark = [pytest.mark.full, pytest.mark.skipif(not CHROMIUM, reason="needs Chromium")]

PRESSES, STOP_P99_S = 200, 0.1
CALLS = 50
"""That the server is busy with while the button is pressed."""
PAINTS, PAINT_S = 20, 1.0
"""One of them may be late."""
CORE_SHARE, IMAGES_HZ, IMAGE_AGE_S, SCENES_HZ = 0.15, 10.0, 0.3, 5.0
FORGOTTEN_S = 10.0
WATCHED_S = 20.0
TWIST = {"linear": {"x": 0.1}}
COUNTED = """(() => {
  window.told = {images: 0, maps: 0, age: [], at: new Set(), from: performance.now()};
  const asked = window.fetch;
  window.fetch = async (...given) => {
    const answer = await asked(...given);
    answer.clone().json().then(({panels}) => {
      if (panels?.map) told.maps++;
      if (!panels?.image?.at_s) return;
      told.images++;
      told.at.add(panels.image.at_s);
      told.age.push(Date.now() / 1000 - panels.image.at_s);
    }, () => null);
    return answer;
  };
})()"""
"""Counts what the page is told, and how old its pictures are then."""


CLOUD_POINTS, CLOUDS_HZ = 59_536, 3.0
"""244 × 244; more than 60,000 are thinned."""
CLOUDS = """(() => {
  window.clouds = {count: 0, age: [], at: {}, from: performance.now()};
  const asked = window.fetch;
  window.fetch = async (...given) => {
    const answer = await asked(...given);
    answer.clone().json().then(({panels, key}) => {
      const cloud = panels?.space?.cloud;
      if (cloud) clouds.at[cloud.key] = cloud.at_s;
      if (key in clouds.at) { clouds.count++; clouds.age.push(Date.now() / 1000 - clouds.at[key]); }
    }, () => null);
    return answer;
  };
})()"""
"""Counts the clouds whose points the page is given, and how old they are then."""


@contextmanager
def seen(environment: dict[str, str], *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process of a page, and its address."""
    with running(environment, sys.executable, "-m", "ros2_mcp", "view", *options) as process:
        assert process.stdout
        yield process, process.stdout.readline().strip()


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with browsing(graphics=True) as page:
        page.look()
        yield page


def told(what: str, **figures: float) -> None:
    values = ", ".join(f"{name} {value:.3f}" for name, value in figures.items())
    print(f"\n{what}: {values}; load {os.getloadavg()[0]:.1f}")


def share(values: list[float], of: float) -> float:
    return sorted(values)[min(len(values) - 1, int(len(values) * of))]


def cpu_s(pid: int) -> float:
    """Of a process and of all that it has begun."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    own = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    children = [
        child for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()
    ]
    return own + sum(cpu_s(int(child)) for child in children)


def reset(environment: Mapping[str, str]) -> None:
    for folder in {path.parent for path in Path(environment["XDG_STATE_HOME"]).glob("ros2-mcp/*/operate-*")}:
        for server in servers_in(folder):
            server.do("reset")
            server.close()


@pytest.mark.parametrize("calls", [0, CALLS])
def test_the_button_s_zero_is_at_a_subscriber_in_time(
    ros_environment: dict[str, str], observer: Observer, page: Page, calls: int
) -> None:
    topic = f"/pressed{calls}/cmd_vel"
    drive = {"topic_name": topic, "message_type": "geometry_msgs/msg/Twist", "data": TWIST}
    with (
        running(ros_environment, *peer_command("camera_peer", "160", "120", "30")),
        seen(ros_environment) as (_, address),
        agent_for(ros_environment) as agent,
    ):
        observer.join(by=topic, topic=topic, kind="geometry_msgs/msg/Twist")
        page.open(address)
        reading = [Reading(agent) for _ in range(calls)]
        took_s: list[float] = []
        for _ in range(PRESSES):
            driving = agent.begin("ros2_topic_publish", **drive, frequency=20.0, duration=600.0)
            until(lambda: observer.driven(topic=topic)[topic])
            page.until(f"{text('#moves')}.startsWith('agent drives')")
            for one in reading:
                one.go_on()
            before = time.monotonic_ns()
            page.run(STOP)
            found = until(lambda after=before: zeros(observer, topic, after))
            took_s.append((found - before) / 1e9)
            page.until(f"/server/.test({text('#said')})")
            driving.exception(30.0)
            reset(ros_environment)
            observer.forget()
        for one in reading:
            one.end()
    told(
        f"stop pressed to zero, {PRESSES} presses beside {calls} calls, s",
        p50=statistics.median(took_s),
        p99=share(took_s, 0.99),
        most=max(took_s),
    )
    assert share(took_s, 0.99) <= STOP_P99_S


def zeros(observer: Observer, topic: str, after: int) -> int:
    """When the first zero after that time came; 0 if none has."""
    return next((one["at"] for one in observer.messages(topic=topic, after=after) if not any(one["values"])), 0)


class Reading:
    """A call that is always under way."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._call = self._begun()

    def _begun(self) -> Any:
        return self._agent.begin("ros2_topic_subscribe", topic_name="/camera/image_raw", duration=60, max_messages=100)

    def go_on(self) -> None:
        if self._call.done():
            self._call = self._begun()

    def end(self) -> None:
        self._call.cancel()


@pytest.mark.parametrize("hertz", ["10", "30"])
@pytest.mark.parametrize("what", ["scene", "noise"])
def test_a_camera_costs_little_and_is_shown_soon(
    ros_environment: dict[str, str], page: Page, hertz: str, what: str
) -> None:
    # reliable: what a socket of this machine has no room for is sent again, so that each picture is paid for
    camera = peer_command("camera_peer", "640", "480", hertz, what, "reliable")
    with running(ros_environment, *camera), seen(ros_environment) as (process, address):
        page.ask("Page.navigate", url="about:blank")
        page.open(address)
        page.until("document.querySelector('#image canvas').ariaLabel")
        page.run(COUNTED)
        time.sleep(2.0)
        before, cpu_before = page.run("[told.at.size, performance.now(), told.images]"), cpu_s(process.pid)
        time.sleep(WATCHED_S)
        after, cpu_after = page.run("[told.at.size, performance.now(), told.images]"), cpu_s(process.pid)
        ages = json.loads(page.run("JSON.stringify(told.age)"))
    seconds = (after[1] - before[1]) / 1000
    shown_hz, used = (after[0] - before[0]) / seconds, (cpu_after - cpu_before) / seconds
    figures = {
        "shown_hz": shown_hz,
        "sent_hz": (after[2] - before[2]) / seconds,
        "age_p50": statistics.median(ages),
        "age_p99": share(ages, 0.99),
        "cores": used,
    }
    told(f"camera 640 x 480 ({what}) at {hertz} Hz", **figures)
    assert shown_hz <= float(hertz) * 1.05, "another robot has a camera here: the demo's begins with the tests below"
    if what == "scene":
        assert share(ages, 0.99) <= IMAGE_AGE_S
        if hertz == "10":
            assert shown_hz >= IMAGES_HZ * 0.9, "else not all that the camera sent was paid for"
            assert used <= CORE_SHARE
        else:
            assert shown_hz >= IMAGES_HZ


@pytest.mark.parametrize("robot", ["rover", "arm", "drone", ""], ids=lambda robot: robot or "recording")
def test_the_page_is_painted_within_a_second(
    ros_environment: dict[str, str], domain_id: int, page: Page, robot: str, tmp_path: Path
) -> None:
    paints: list[float] = []
    filled: list[float] = []
    with ExitStack() as stack:
        environment, options = ros_environment, list[str]()
        if robot:
            of_its_own = {**ros_environment, "ROS_DOMAIN_ID": str(domain_id + 1)}
            environment = with_interfaces(of_its_own, build_interfaces(robot, later=True))
            stack.enter_context(running(environment, sys.executable, "-m", "ros2_mcp_demo", "--robot", robot))
        else:
            options = ["--bag", str(room_bag(tmp_path / "room"))]
        _, address = stack.enter_context(seen(environment, *options))
        for _ in range(PAINTS):
            page.ask("Page.navigate", url="about:blank")
            page.open(address)
            paints.append(page.until("performance.getEntriesByName('first-contentful-paint')[0]?.startTime") / 1000)
            page.until("/Robot at/.test(document.querySelector('#map canvas').ariaLabel)")
            filled.append(page.run("performance.now()") / 1000)
    what = robot or "recording"
    told(f"first contentful paint of the {what}, s", p50=statistics.median(paints), most=max(paints))
    told(f"the {what} is placed on the map, s", p50=statistics.median(filled), most=max(filled))
    assert sum(one <= PAINT_S for one in paints) >= PAINTS - 1


def test_a_large_cloud_is_shown_soon_and_costs_what_it_weighs(
    demo_environment: dict[str, str], demo_robot: object, page: Page
) -> None:
    peer = running(demo_environment, *peer_command("cloud_peer", "laser", str(CLOUD_POINTS)))
    with peer, seen(demo_environment) as (process, address):
        page.ask("Page.navigate", url="about:blank")
        page.open(address)
        page.run("document.querySelector('[aria-controls=space]').click()")
        page.until(f"/ {CLOUD_POINTS} points of/.test(document.querySelector('#space canvas').ariaLabel)", 30.0)
        page.run(CLOUDS)
        used = watched_cpu(process.pid)
        shown_hz = page.run("clouds.count / (performance.now() - clouds.from) * 1000")
        ages = json.loads(page.run("JSON.stringify(clouds.age)"))
    figures = {
        "shown_hz": shown_hz,
        "age_p50": statistics.median(ages),
        "age_most": max(ages),
        "cores": used,
    }
    told(f"a cloud of {CLOUD_POINTS} points at 5 Hz", **figures)
    assert shown_hz >= CLOUDS_HZ


def test_the_scene_is_live_and_a_forgotten_page_costs_nothing(
    demo_environment: dict[str, str], demo_robot: object, page: Page
) -> None:
    with seen(demo_environment) as (process, address):
        idle = watched_cpu(process.pid)
        page.ask("Page.navigate", url="about:blank")
        page.open(address)
        page.until("document.querySelector('#map canvas').ariaLabel")
        page.run(COUNTED)
        busy = watched_cpu(process.pid)
        scenes_hz = page.run("told.maps / (performance.now() - told.from) * 1000")
        page.ask("Page.navigate", url="about:blank")
        time.sleep(FORGOTTEN_S + 2.0)
        closed = watched_cpu(process.pid)
    told("the demo robot's page", scenes_hz=scenes_hz, cores=busy)
    told("cores of a page that was closed 10 s ago", closed=closed, never_opened=idle)
    assert scenes_hz >= SCENES_HZ * 0.98  # a clock of 5 Hz tells 4.9 now and then
    assert closed <= idle + 0.02


def watched_cpu(pid: int, seconds: float = 10.0) -> float:
    """The processors that are used by it, and what it has begun, for a while."""
    began, before = time.monotonic(), cpu_s(pid)
    time.sleep(seconds)
    return (cpu_s(pid) - before) / (time.monotonic() - began)
