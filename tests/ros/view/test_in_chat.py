"""The page inside a chat: a real Chromium, a host page that speaks MCP Apps, a real server, a simulated robot."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import FULL, Agent, agent_for, until
from support.browser import CHROMIUM, Page, browsing
from support.chat_host import APPS, KINDS, ChatHost, hosting
from support.observer import Observer
from support.on_map import FREE, WALL, click_on_map

Reset = Callable[[], None]
TWIST = {"linear": {"x": 0.1}}
REST_S = 10.0 if FULL else 30.0
PICTURES = os.environ.get("ROS2_MCP_PICTURES")
OURS = "!!document.querySelector('#map canvas')"
LIVE = "document.getElementById('state').textContent === 'live'"
PLACED = "/Robot at -?[0-9.]+, -?[0-9.]+ metres in map/.test(document.querySelector('#map canvas').ariaLabel ?? '')"
SETTLED = "new Promise(done => setTimeout(() => done(host.views[0].calls), 600))"
"""The calls of a page, after a time in which it asks several times."""
PICTURED = "!!document.querySelector('#image canvas').ariaLabel"


def at_rest(chat: Page) -> int:
    """Waits until the page asks nothing any more, which a busy browser lets it know late: its calls by then."""
    until(lambda: chat.run("host.views[0].calls") == chat.run(SETTLED))
    return chat.run("host.views[0].calls")


@pytest.fixture(scope="module")
def agent(demo_environment: dict[str, str], demo_robot: object) -> Iterator[Agent]:
    with agent_for(demo_environment, extensions=[APPS]) as client:
        yield client


@pytest.fixture(scope="module")
def host(agent: Agent) -> Iterator[ChatHost]:
    with hosting(agent) as found:
        yield found


@pytest.fixture(scope="module")
def browser() -> Iterator[Page]:
    if not CHROMIUM:
        pytest.skip("needs Chromium")
    with browsing() as page:
        yield page


@pytest.fixture
def chat(browser: Page, host: ChatHost) -> Iterator[Page]:
    """A new chat, which closes its pages at the end, as hosts do."""
    browser.look(width=900, height=1000)
    browser.complaints.clear()
    browser.open(host.address)
    host.asked.clear()
    yield browser
    browser.run("Promise.all(host.views.map(view => host.ask(view.index, 'ui/resource-teardown')))")
    browser.until("host.views.every(view => view.inFlight === 0)")


def shown(chat: Page, kind: str = "srcdoc", arguments: Any = None, **options: Any) -> int:
    """Opens a view in a chat; where its scripts run."""
    before = set(chat.frames(OURS))
    chat.run(f"host.open({json.dumps(kind)}, {json.dumps(arguments or {})}, {json.dumps(options)})")
    (view,) = until(lambda: [one for one in chat.frames(OURS) if one not in before])
    return view


@pytest.fixture
def reset(demo_environment: dict[str, str]) -> Reset:
    """What a person does in a terminal after a stop."""

    def by_operator() -> None:
        command = [sys.executable, "-m", "ros2_mcp", "operate", "reset"]
        subprocess.run(command, env=demo_environment, check=True, stdout=subprocess.DEVNULL)

    return by_operator


def pictured(page: Page, name: str) -> None:
    if PICTURES:
        page.picture(Path(PICTURES) / f"{name}.png")


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_lives_in_a_chat_however_it_is_framed(chat: Page, kind: str) -> None:
    view = shown(chat, kind)
    chat.until(LIVE, within=view)
    chat.until(f"{PLACED} && {PICTURED}", within=view)
    assert chat.until("host.views[0].said.some(one => one.method === 'ui/notifications/size-changed')")
    chat.until("host.views[0].frame.clientHeight > 400")  # as high as what it shows
    assert chat.run("document.documentElement.scrollHeight <= innerHeight + 1", within=view)
    pictured(chat, f"chat-{kind}")
    assert chat.run("host.views[0].most") == 1  # one question for news at a time
    assert chat.complaints == []


def test_it_follows_the_chats_theme_and_size_and_asks_nothing_when_it_is_not_seen(chat: Page, host: ChatHost) -> None:
    view = shown(chat, context={})  # a host that says nothing of itself
    chat.until(LIVE, within=view)
    news = {"theme": "dark", "availableDisplayModes": ["inline", "fullscreen"]}
    chat.run(f"host.tell(0, 'ui/notifications/host-context-changed', {json.dumps(news)})")
    chat.until("document.documentElement.dataset.theme === 'dark'", within=view)
    pictured(chat, "chat-dark")
    chat.run("document.getElementById('size').click()", within=view)
    chat.until("document.getElementById('log').offsetParent !== null", within=view)
    chat.until("document.querySelector('#values .tree').textContent.includes('base_link')", within=view)
    pictured(chat, "chat-full")
    chat.run("host.views[0].frame.style.marginTop = '3000px'")  # out of sight
    asked = at_rest(chat)
    chat.run("host.views[0].frame.style.marginTop = '0'")
    chat.until(f"host.views[0].calls > {asked}")
    assert chat.run("host.ask(0, 'ui/resource-teardown').then(answer => JSON.stringify(answer.result))") == "{}"
    chat.until("/closed/.test(document.getElementById('state').textContent)", within=view)
    at_rest(chat)
    assert host.asked[-1][1]["asked"]["closed"] is True
    assert chat.complaints == []


def test_its_button_stops_the_agent_of_the_chat(chat: Page, agent: Agent, observer: Observer, reset: Reset) -> None:
    view = shown(chat)
    chat.until(LIVE, within=view)
    observer.watch("/cmd_vel")
    driving = agent.begin(
        "ros2_topic_publish",
        **{"topic_name": "/cmd_vel", "message_type": "geometry_msgs/msg/Twist", "data": TWIST},
        frequency=10.0,
        duration=40.0,
    )
    observer.until_driven("/cmd_vel")
    chat.until("document.getElementById('moves').textContent.startsWith('agent drives /cmd_vel')", within=view)
    chat.run("document.getElementById('stop').click()", within=view)
    assert observer.comes_to_rest("/cmd_vel", REST_S) == []
    said = "document.getElementById('said').textContent"
    assert "the latch is set" in chat.until(f"/1 of 1 server/.test({said}) && {said}", within=view)
    pictured(chat, "chat-stopped")
    assert driving.exception(REST_S) is not None or driving.result()["status"]
    chat.until("document.getElementById('moves').textContent.startsWith('LATCHED by operator')", within=view)
    state = agent.call("ros2_view_state")["pages"][0]
    assert any("LATCHED" in line for line in state["panels"])
    assert chat.complaints == []
    reset()


def test_a_click_on_the_map_is_a_place_for_the_model(chat: Page, agent: Agent) -> None:
    view = shown(chat)
    chat.until(f"{LIVE} && {PLACED}", within=view)
    chat.until("host.views[0].frame.clientHeight > 400")
    left, top = chat.run("(({left, top}) => [left, top])(host.views[0].frame.getBoundingClientRect())")
    for colour, about in ((WALL, "occupied on /map"), (FREE, "free on /map")):
        click_on_map(chat, colour, within=view, left=left, top=top)
        told = (
            "host.views[0].said.filter(one => one.method === 'ui/update-model-context').at(-1)?.params.content[0].text"
        )
        chat.until(f"{told}?.includes({json.dumps(about)})")
        (seen,) = [page for page in agent.call("ros2_view_state")["pages"] if page["picked"]]
        (place,) = seen["picked"]
        assert (place["frame"], place["about"]) == ("map", about)
        assert f"({place['x_m']:.2f}, {place['y_m']:.2f}) m" in chat.run(told)
    pictured(chat, "chat-picked")
    chat.run("document.querySelector('.picked button').click()", within=view)
    said = chat.until("host.views[0].said.find(one => one.method === 'ui/message')?.params")
    assert said["role"] == "user" and "free on /map" in said["content"][0]["text"]
    chat.run("document.querySelector('.picked button:last-child').click()", within=view)
    chat.until(
        "host.views[0].said.filter(one => one.method === 'ui/update-model-context').at(-1).params.content.length === 0"
    )
    until(lambda: not any(page["picked"] for page in agent.call("ros2_view_state")["pages"]))
    assert chat.complaints == []


def test_it_bears_a_chat_that_is_slow_or_fails_and_two_views_do_not_meet(chat: Page, agent: Agent) -> None:
    one = shown(chat)
    chat.until(LIVE, within=one)
    other = shown(chat, arguments={"topics": ["/odom"]})
    chat.until(f"{LIVE} && document.querySelector('#values .tree').textContent.includes('base_link')", within=other)
    assert chat.run("document.getElementById('values').offsetParent === null", within=one)
    pages = [page for page in agent.call("ros2_view_state")["pages"] if page["open"]]
    assert {any(line.startswith("values: /odom") for line in page["panels"]) for page in pages} == {True, False}
    note = agent.call("ros2_view", topics=["/map"])["note"]
    assert re.search(r"[2-4] pages are open already and unchanged", note), note  # one of a test before may still end
    assert "heads of its panels" in note
    state = "document.getElementById('state').textContent"
    chat.run("host.failing = 'the host has no time'")
    for view in (one, other):
        chat.until(f"{state}.includes('the host has no time')", within=view)
    chat.run("host.failing = ''; host.huge = 3e6")
    chat.until("document.querySelector('#map .why').textContent.length > 1e6", within=one)
    chat.run("host.huge = 0; host.slowMs = 700")
    chat.until(f"{LIVE} && {PLACED}", within=one)
    assert chat.run("Math.max(...host.views.map(one => one.most))") == 1
    assert chat.complaints == []


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"cancelled": True}, "the call was cancelled"),
        ({"can": {}}, "lets no page ask its server"),
    ],
)
def test_it_says_why_it_shows_nothing(chat: Page, options: dict[str, Any], why: str) -> None:
    view = shown(chat, **options)
    chat.until(f"document.getElementById('state').textContent.includes({json.dumps(why)})", within=view)
    asked = at_rest(chat)
    assert asked <= 1  # the first question may have been on its way
    assert chat.run(SETTLED) == asked
    assert chat.complaints == []
