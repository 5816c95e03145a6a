"""The page in a real Chromium, beside a real agent that drives the simulated robot, and of a recording."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import FULL, Agent, agent_for, until
from support.browser import CHROMIUM, Page, browsing
from support.observer import Observer
from support.on_map import WALL, click_on_map
from support.processes import peer_command, running
from support.viewing import STOP, choose, complaints, pictured, pictured_in_all_sizes, text, viewing

TWIST = {"linear": {"x": 0.1}}
REST_S = 10.0 if FULL else 30.0


@pytest.fixture(scope="module")
def browser() -> Iterator[Page]:
    if not CHROMIUM:
        pytest.skip("needs Chromium")
    with browsing() as page:
        yield page


@pytest.fixture(scope="module")
def agent(
    demo_environment: dict[str, str], demo_robot: object, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Agent]:
    folder = str(tmp_path_factory.mktemp("recordings"))
    with agent_for(demo_environment, "--tools", "default,memory", "--record-dir", folder) as client:
        yield client


@pytest.fixture(scope="module")
def page(demo_environment: dict[str, str], agent: Agent, browser: Page) -> Iterator[Page]:
    """The page of the simulated robot."""
    with viewing(demo_environment) as address:
        browser.look()
        browser.open(address)
        yield browser


@pytest.mark.promise("README", "sees in a browser what it sees and does")
def test_the_page_shows_what_the_robot_sees_and_where_it_is(page: Page) -> None:
    page.until("document.querySelector('#image canvas').ariaLabel")
    page.until("/Robot at -?[0-9.]+, -?[0-9.]+ metres in map/.test(document.querySelector('#map canvas').ariaLabel)")
    page.until(f"{text('#values .tree')}.includes('base_link')")
    told = page.run(text("#values .tree"))
    assert told.index("position") < told.index("linear") < told.index("angular") < told.index("header")
    page.until(f"{text('#state')} === 'live'")
    assert "#" not in page.run("location.href")  # the token is out of the address
    for name, width, height, dark in (
        ("wide", 1440, 900, False),
        ("dark", 1440, 900, True),
        ("narrow", 390, 800, True),
    ):
        page.look(width=width, height=height, dark=dark)
        page.until(f"document.documentElement.dataset.theme === '{'dark' if dark else 'light'}'")
        assert page.run("document.documentElement.scrollWidth <= innerWidth"), name
        pictured(page, name)
    page.look()
    assert complaints(page) == []


def driving(agent: Agent, observer: Observer) -> Future[dict[str, Any]]:
    """The agent drives the robot, and the observer has heard it."""
    observer.watch("/cmd_vel")
    call = agent.begin(
        "ros2_topic_publish",
        **{"topic_name": "/cmd_vel", "message_type": "geometry_msgs/msg/Twist", "data": TWIST},
        frequency=10.0,
        duration=40.0,
    )
    observer.until_driven("/cmd_vel")
    return call


@pytest.fixture
def operator(demo_environment: dict[str, str]) -> Iterator[None]:
    """Resets after the test what its stop has latched."""
    yield
    operate = [sys.executable, "-m", "ros2_mcp", "operate"]
    subprocess.run([*operate, "reset"], env=demo_environment, check=True, stdout=subprocess.DEVNULL)


def test_what_is_picked_in_the_browser_is_told_to_the_agent(page: Page, agent: Agent) -> None:
    page.look()
    click_on_map(page, WALL)
    page.until("document.querySelector('.picked').textContent.includes('The agent sees it')")
    pictured(page, "picked")
    (seen,) = agent.call("ros2_view_state")["pages"]
    assert seen["subject"] == "the robot now, in a browser"
    assert [(one["frame"], one["about"]) for one in seen["picked"]] == [("map", "occupied on /map")]
    assert complaints(page) == []


@pytest.mark.promise("README", "Its one button stops every server that acts on the robot from this machine")
@pytest.mark.usefixtures("operator")
def test_the_button_stops_the_agent_and_says_who_answered(page: Page, agent: Agent, observer: Observer) -> None:
    recording = agent.call("ros2_record_start", topic_names=["/odom"])["recording_id"]
    call = driving(agent, observer)
    page.until(f"{text('#moves')}.startsWith('agent drives /cmd_vel')")
    page.until(
        f"{text('#agent')}.includes('1 topic into') && {text('#agent .rows:last-of-type')}.includes('under way')"
    )
    pictured_in_all_sizes(page, "driving")
    page.run(STOP)
    assert observer.comes_to_rest("/cmd_vel", REST_S) == []
    said = page.until(f"/1 of 1 server/.test({text('#said')}) && {text('#said')}")
    assert "the latch is set" in said
    page.until(f"{text('#moves')}.startsWith('LATCHED by operator')")
    rows = "[...document.querySelectorAll('#agent .rows:last-of-type li')].map(row => row.textContent)"
    page.until(f"{rows}.some(row => /stop .*by operator.*latched$/.test(row))")
    assert page.run(f"{rows}.filter(row => /by operator/.test(row)).length") == 1  # one press, one row
    pictured_in_all_sizes(page, "stopped")
    assert call.exception(REST_S) is not None or call.result()["status"]
    assert agent.call("ros2_record_stop", recording_id=recording)["messages"] > 0  # it moves nothing, and goes on
    page.until(f"{rows}.some(row => row.includes('recording ended {recording}'))")
    assert "latch" in agent.refusal(
        "ros2_topic_publish", topic_name="/cmd_vel", message_type="geometry_msgs/msg/Twist", data=TWIST
    )
    assert complaints(page) == []


def test_a_box_that_is_drawn_in_a_depth_picture_is_told_with_the_depth_there(page: Page, agent: Agent) -> None:
    page.until("document.querySelector('#image option[value=\"/camera/depth/image_raw\"]') !== null")
    page.run(choose("image", "/camera/depth/image_raw"))
    page.until("document.querySelector('#image canvas').ariaLabel?.includes('Depth (')")
    left, top, width, height = page.rectangle("#image canvas")
    page.drag((left + width * 0.45, top + height * 0.55), (left + width * 0.55, top + height * 0.8))
    told = page.until(
        "/Picked .*depth there .*The agent sees it/.exec(document.querySelector('.picked').textContent)?.[0]"
    )
    pictured_in_all_sizes(page, "picked-box")
    (seen,) = agent.call("ros2_view_state")["pages"]
    (box,) = seen["picked"]
    x1, y1, x2, y2 = box["box_px"]
    across, down = box["image_size_px"]
    assert 0 < x1 < across / 2 < x2 < across and down / 2 < y1 < y2 < down
    assert f"{x2 - x1 + 1} × {y2 - y1 + 1} pixels of /camera/depth/image_raw" in told
    assert 0.1 < box["depth_m"] < 10.0 and f"depth there {box['depth_m']:.2f} m" in told
    assert box["frame"] and box["age_s"] < 30.0
    page.run(choose("image", "/camera/image_raw"))
    page.until("!document.querySelector('#image canvas').ariaLabel.includes('Depth (')")
    assert not page.run("document.querySelector('.picked .where').hidden")  # it is on the other picture
    assert complaints(page) == []


@pytest.mark.usefixtures("operator")
def test_a_stop_that_is_not_confirmed_looks_like_an_alarm(
    page: Page, agent: Agent, demo_environment: dict[str, str], observer: Observer
) -> None:
    driving(agent, observer)
    page.until(f"{text('#moves')}.startsWith('agent drives /cmd_vel')")
    with running(demo_environment, *peer_command("stranger_peer", "/cmd_vel")):  # publishes there, too
        until(lambda: "/stranger" in str(agent.call("ros2_topic_info", topic_name="/cmd_vel")))
        page.run(STOP)
        said = page.until(f"/of 1 server/.test({text('#said')}) && {text('#said')}")
    assert (
        "The robot appears to stand still, but this is NOT confirmed" in said and "also publishes on /cmd_vel" in said
    )
    assert "emergency stop" in said
    assert not page.run("document.getElementById('said').classList.contains('ok')")
    pictured_in_all_sizes(page, "doubted")


@pytest.mark.usefixtures("operator")
def test_where_a_server_hangs_the_latch_is_set_and_the_page_says_that_it_did_not_answer(
    page: Page, agent: Agent, demo_environment: dict[str, str], observer: Observer
) -> None:
    driving(agent, observer)
    page.until(f"{text('#moves')}.startsWith('agent drives /cmd_vel')")
    pid = server_of(demo_environment)
    os.kill(pid, signal.SIGSTOP)
    try:
        page.run(STOP)
        assert observer.comes_to_rest("/cmd_vel", REST_S) == []
        page.until(f"{text('#said')}.includes('NO ANSWER')")
        said = page.run(text("#said"))
        assert "zeros were sent from here on /cmd_vel" in said and "the latch is set" in said
    finally:
        os.kill(pid, signal.SIGCONT)


def server_of(environment: dict[str, str]) -> int:
    """The process of the only server that has acted: the one that has written the lock."""
    (lock,) = Path(environment["XDG_STATE_HOME"]).glob("ros2-mcp/*/server.lock")
    found = re.search(r'"pid": (\d+)', lock.read_text())
    assert found
    return int(found[1])


def test_what_is_old_looks_old_and_a_page_without_its_server_says_so(
    page: Page, demo_robot: subprocess.Popen[bytes]
) -> None:
    page.until("!document.getElementById('image').classList.contains('stale')")
    os.kill(demo_robot.pid, signal.SIGSTOP)
    try:
        page.until("['image', 'map', 'values'].every(id => document.getElementById(id).classList.contains('stale'))")
        pictured_in_all_sizes(page, "stale")
    finally:
        os.kill(demo_robot.pid, signal.SIGCONT)
    page.until("!document.getElementById('image').classList.contains('stale')")
