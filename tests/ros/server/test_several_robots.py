"""Several robots in one server: each by its name, each for itself. Two ROS domains stand for two robots."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from anyio.from_thread import start_blocking_portal
from mcp.shared.exceptions import MCPError

from ros2_mcp.guard.state import StateFolder
from support.agent import FULL, Agent, agent_for, until
from support.observer import TWIST, Observer, observing
from support.ports import listening
from support.raw_server import MODERN, RawServer
from support.standstill import undisturbed
from support.tokens import client_at

FORWARD = {"linear": {"x": 0.3}}
AWAY_COSTS_S = 0.05
"""How much longer a call may take because another robot is away: bar 6 of the notes."""
CALLS = 15
"""Calls whose median is compared: one late one says nothing."""
USUAL_S = 0.05
"""A list of topics takes some 3 ms on a quiet machine."""
LEAVES_S = 8.0
"""Of a server, which leaves within 2 s on a quiet machine."""
REST_S = 3.0 if FULL else 30.0
"""Others measure how soon a robot stands; here it matters which one does."""


def median_s(agent: Agent, robot: str) -> float:
    """How long a call takes."""
    took: list[float] = []
    for _ in range(CALLS):
        begun = time.perf_counter()
        agent.call("ros2_topic_list", robot=robot)
        took.append(time.perf_counter() - begun)
    print(f"{robot}: {statistics.median(took) * 1000:.1f} ms")
    return statistics.median(took)


@pytest.fixture(scope="module")
def robots(domain_id: int) -> dict[str, int]:
    """The robots of this file: name and domain."""
    return {"lab": domain_id, "yard": domain_id + 1}


@pytest.fixture(scope="module")
def options(robots: dict[str, int], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What names them to a server."""
    named = [word for name, domain in robots.items() for word in ("--robot", f"{name}=local?domain_id={domain}")]
    return [*named, "--tools", "all", "--record-dir", str(tmp_path_factory.mktemp("recordings"))]


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str], options: list[str]) -> Iterator[Agent]:
    with agent_for(ros_environment, *options) as client:
        for robot in ("lab", "yard"):
            client.until_answered("ros2_status", robot=robot)
        yield client


@pytest.fixture(scope="module")
def observers(ros_environment: dict[str, str], robots: dict[str, int]) -> Iterator[dict[str, Observer]]:
    """One on each robot: it alone judges what reached it."""
    with ExitStack() as running:
        yield {
            name: running.enter_context(observing({**ros_environment, "ROS_DOMAIN_ID": str(domain)}))
            for name, domain in robots.items()
        }


@pytest.fixture
def driven(
    observers: dict[str, Observer], request: pytest.FixtureRequest
) -> Iterator[Callable[[Agent, str], tuple[Observer, str]]]:
    """Drive a robot on a topic of the test's own; gives the observer that sees it, and the topic."""
    joined: list[tuple[Observer, str]] = []

    def drive(agent: Agent, robot: str) -> tuple[Observer, str]:
        observer, topic = observers[robot], f"/{robot}/{request.node.name}/cmd_vel".replace("[", "_").replace("]", "")
        observer.join(by=topic, topic=topic, kind=TWIST)
        joined.append((observer, topic))
        how = {"topic_name": topic, "message_type": TWIST, "data": FORWARD, "frequency": 20, "duration": 60}
        agent.begin("ros2_topic_publish", robot=robot, **how)
        observer.until_driven(topic)
        return observer, topic

    yield drive
    for observer, topic in joined:
        observer.leave(by=topic)


@pytest.mark.promise("README", "Every tool then needs robot, the name of one")
def test_each_tool_needs_the_name_of_a_robot_and_none_is_the_default(agent: Agent) -> None:
    tools = agent.tools()
    names = ["lab", "yard"]
    for name, tool in tools.items():
        taken = tool.input_schema
        if name == "ros2_robots":
            assert taken["properties"] == {}
            continue
        assert taken["properties"]["robot"]["enum"] == names, name
        assert ("robot" in taken.get("required", ())) == (name != "ros2_stop"), name
    assert "ros2_topic_list needs the argument 'robot': lab, yard." in agent.refusal("ros2_topic_list")


def test_a_robot_that_there_is_not_is_refused_with_the_names_that_there_are(agent: Agent) -> None:
    refused = agent.refusal("ros2_topic_list", robot="labb")
    assert "There is no robot «labb». Did you mean lab? There are: lab, yard." in refused


def test_each_robot_is_asked_for_itself(agent: Agent, robots: dict[str, int]) -> None:
    states = {name: agent.call("ros2_status", robot=name) for name in robots}
    assert {name: (state["robot"], state["domain_id"]) for name, state in states.items()} == {
        name: (name, domain) for name, domain in robots.items()
    }
    whole = agent.whole("ros2_status", {"robot": "yard"})
    assert whole.content[0].text.startswith("Robot yard: ROS 2 ")  # type: ignore[union-attr]


def test_the_robots_are_shown_with_what_may_be_done_to_them(agent: Agent, robots: dict[str, int]) -> None:
    shown = {robot["robot"]: robot for robot in agent.call("ros2_robots")["robots"]}
    assert list(shown) == ["lab", "yard"]
    for name, robot in shown.items():
        assert robot["state"] in ("connected", "connecting")
        address = f"local?domain_id={robots[name]}"
        assert (robot["address"], robot["read_only"], robot["latched"]) == (address, False, False)
        if robot["state"] == "connected":
            assert robot["domain_id"] == robots[name]


def test_what_is_published_reaches_the_named_robot_alone(
    agent: Agent, driven: Callable[[Agent, str], tuple[Observer, str]], observers: dict[str, Observer]
) -> None:
    _, topic = driven(agent, "lab")
    listed = agent.call("ros2_topic_list", robot="yard", pattern=topic)["topics"]
    assert listed == []
    assert agent.call("ros2_topic_list", robot="lab", pattern=topic)["topics"] != []
    agent.call("ros2_stop", robot="lab")


@pytest.mark.promise("README", "ros2_stop without it stops them all")
def test_a_stop_of_one_robot_leaves_the_other_moving_and_one_without_a_name_stops_both(
    agent: Agent, driven: Callable[[Agent, str], tuple[Observer, str]]
) -> None:
    (lab, on_lab), (yard, on_yard) = driven(agent, "lab"), driven(agent, "yard")
    stopped = agent.call("ros2_stop", robot="lab")
    assert [one["robot"] for one in stopped["robots"]] == ["lab"]
    assert lab.comes_to_rest(on_lab, REST_S) == []
    yard.forget()
    yard.until_driven(on_yard, 3)
    both = agent.call("ros2_stop")
    assert [one["robot"] for one in both["robots"]] == ["lab", "yard"]
    assert yard.comes_to_rest(on_yard, REST_S) == []
    assert [topic["topic_name"] for topic in both["robots"][1]["stopped"]["topics"]] == [on_yard]


def test_a_stop_of_a_robot_that_there_is_not_stops_all(
    agent: Agent, driven: Callable[[Agent, str], tuple[Observer, str]]
) -> None:
    yard, topic = driven(agent, "yard")
    stopped = agent.call("ros2_stop", robot="yrad", now=True)
    assert "There is no robot «yrad»: all were told to stop. ros2_stop has no argument «now»" in stopped["note"]
    assert yard.comes_to_rest(topic, REST_S) == []


def test_each_robot_records_into_a_folder_of_its_own(agent: Agent, options: list[str]) -> None:
    folder = Path(options[-1])
    for robot in ("lab", "yard"):
        started = agent.call("ros2_record_start", robot=robot, name="run", topic_names=["/rosout"])
        assert Path(started["path"]).is_relative_to(folder / robot)
        agent.call("ros2_record_stop", robot=robot)
    assert sorted(found.parent.name for found in folder.glob("*/run*")) == ["lab", "yard"]


def test_resources_say_which_robot_they_are_about(agent: Agent) -> None:
    uris = {str(row.uri) for row in agent.ask("list_resources").resources}
    assert {"ros2://graph?robot=lab", "ros2://graph?robot=yard"} < uris
    templates = {row.uri_template for row in agent.ask("list_resource_templates").resource_templates}
    assert {"ros2://log{?level,node,robot}", "ros2://topic/{+name}{?robot}"} < templates
    for robot in ("lab", "yard"):
        for uri in (f"ros2://topics?robot={robot}", f"ros2://log?robot={robot}&level=warn"):
            assert json.loads(agent.ask("read_resource", uri).contents[0].text)["robot"] == robot
    with pytest.raises(MCPError, match=r"has to say which robot it is about.*There are: lab, yard\."):
        agent.ask("read_resource", "ros2://topics")
    with pytest.raises(MCPError, match=r"There is no robot «yrad»\. Did you mean yard\?"):
        agent.ask("read_resource", "ros2://topics?robot=yrad")


def test_what_a_client_over_http_moves_ends_on_every_robot_when_it_goes(
    ros_environment: dict[str, str],
    options: list[str],
    observers: dict[str, Observer],
    driven: Callable[[Agent, str], tuple[Observer, str]],
) -> None:
    """It repeats on one, in an open call, and has published once on the other."""
    yard, once = observers["yard"], "/yard/once/cmd_vel"
    yard.join(by=once, topic=once, kind=TWIST)
    with listening(ros_environment, "streamable-http", *options) as (port, _), start_blocking_portal() as portal:
        with portal.wrap_async_context_manager(client_at(f"http://127.0.0.1:{port}/mcp")) as client:
            agent = Agent(client, portal)
            lab, repeated = driven(agent, "lab")
            agent.call("ros2_topic_publish", robot="yard", topic_name=once, message_type=TWIST, data=FORWARD)
            yard.until_driven(once)
            assert yard.moving(topic=once) == [once], "it moves for as long as its client is there"
        assert lab.comes_to_rest(repeated, REST_S) == []
        assert yard.comes_to_rest(once, REST_S) == []
    yard.leave(by=once)


def test_a_robot_that_is_away_holds_up_no_other(agent: Agent) -> None:
    """Its bridge is stopped from outside: for half a second it neither answers nor dies. Then another one begins.

    If the other robot were held up, it could never answer first, however often that is tried.
    """

    def answers_first() -> bool:
        os.kill(agent.call("ros2_status", robot="lab")["bridge_pid"], signal.SIGSTOP)
        asked = [agent.begin("ros2_topic_list", robot="lab") for _ in range(4)]
        agent.call("ros2_topic_list", robot="yard")
        was_first = not any(call.done() for call in asked)
        for call in asked:
            call.cancel()
        agent.until_answered("ros2_status", robot="lab")
        return was_first

    until(answers_first)


@pytest.mark.full
def test_calls_take_no_longer_while_another_robot_is_away(agent: Agent) -> None:
    pids = {name: agent.call("ros2_status", robot=name)["bridge_pid"] for name in ("lab", "yard")}
    before_s = undisturbed(lambda: median_s(agent, "yard"))
    os.kill(pids["lab"], signal.SIGSTOP)
    asked = [agent.begin("ros2_topic_list", robot="lab") for _ in range(4)]
    away_s = undisturbed(lambda: median_s(agent, "yard"))
    for call in asked:
        call.cancel()
    assert away_s < before_s + AWAY_COSTS_S


@pytest.mark.skipif(not shutil.which("ssh"), reason="needs ssh")
def test_a_robot_that_is_never_reached_holds_up_no_other_and_no_stop(
    ros_environment: dict[str, str],
    robots: dict[str, int],
    driven: Callable[[Agent, str], tuple[Observer, str]],
) -> None:
    with never_reached(ros_environment, robots) as agent:

        def answers_first() -> Future[Any] | None:
            waiting = agent.begin("ros2_topic_list", robot="lab")
            agent.call("ros2_topic_list", robot="yard")
            return None if waiting.done() else waiting

        waiting = until(answers_first)  # it waits as long as ssh, for 10 s, which may just be over
        states = {robot["robot"]: robot["state"] for robot in agent.call("ros2_robots")["robots"]}
        assert (states["lab"] in ("connecting", "away"), states["yard"]) == (True, "connected")
        yard, topic = driven(agent, "yard")
        stopped = {one["robot"]: one["stopped"] for one in agent.call("ros2_stop")["robots"]}
        assert yard.comes_to_rest(topic, REST_S) == []
        assert "has never reached it" in stopped["lab"]["note"]
        assert [found["topic_name"] for found in stopped["yard"]["topics"]] == [topic]
        waiting.cancel()


@contextmanager
def never_reached(environment: dict[str, str], robots: dict[str, int]) -> Iterator[Agent]:
    """A client of a server whose robot `yard` is there; at the address of `lab` somebody listens, and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        named = {
            "lab": f"ssh://nobody@127.0.0.1:{silent.getsockname()[1]}",
            "yard": f"local?domain_id={robots['yard']}",
        }
        options = [word for name, address in named.items() for word in ("--robot", f"{name}={address}")]
        with agent_for(environment, *options, "--ssh-option=-F/dev/null") as agent:
            agent.call("ros2_status", robot="yard")
            yield agent


@pytest.mark.full
@pytest.mark.skipif(not shutil.which("ssh"), reason="needs ssh")
def test_calls_take_no_longer_while_another_robot_is_never_reached(
    ros_environment: dict[str, str], robots: dict[str, int]
) -> None:
    with never_reached(ros_environment, robots) as agent:
        waiting = agent.begin("ros2_topic_list", robot="lab")
        assert undisturbed(lambda: median_s(agent, "yard")) < USUAL_S + AWAY_COSTS_S
        waiting.cancel()


@pytest.mark.skipif(not shutil.which("ssh"), reason="needs ssh")
def test_a_server_leaves_at_once_also_where_a_black_box_waits_for_a_robot_that_is_not_reached(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        named = (
            ("--robot", f"{name}=ssh://nobody@127.0.0.1:{port}?domain_id={domain}") for domain, name in enumerate("ab")
        )
        patient = ("--ssh-option=-F/dev/null", "--ssh-option=-oConnectTimeout=120")
        kept = ("--black-box", "", "--record-dir", str(tmp_path), *patient)
        server = RawServer(ros_environment, *(word for words in named for word in words), *kept)
        try:
            server.begin(MODERN)
            until(lambda: len(list(tmp_path.glob("*/black-box"))) == 2)
            took_s = server.close()  # within 20 s: who waits for ssh takes longer
            if FULL:
                assert took_s < LEAVES_S
        finally:
            server.end()


def test_a_robot_of_the_file_has_rules_of_its_own(
    ros_environment: dict[str, str], robots: dict[str, int], tmp_path: Path
) -> None:
    """One may not be written to: tools that write do not offer it. The other is under a policy."""
    file = tmp_path / "robots.yaml"
    entries: dict[str, Any] = {
        "lab": {"at": f"local?domain_id={robots['lab']}", "read_only": True},
        "yard": {"at": "local", "domain_id": robots["yard"], "policy": "teleop-slow"},
    }
    file.write_text(json.dumps({"robots": entries}))  # YAML is more than JSON
    own_state = {**ros_environment, "XDG_STATE_HOME": str(tmp_path / "state")}  # it sets a latch
    with agent_for(own_state, "--robots", str(file)) as agent:
        tools = agent.tools()
        assert tools["ros2_topic_publish"].input_schema["properties"]["robot"]["enum"] == ["yard"]
        assert tools["ros2_topic_list"].input_schema["properties"]["robot"]["enum"] == ["lab", "yard"]
        twist = {"topic_name": "/cmd_vel", "message_type": TWIST, "data": FORWARD}
        assert "read-only" in agent.refusal("ros2_topic_publish", robot="lab", **twist)
        shown = {robot["robot"]: robot for robot in agent.call("ros2_robots")["robots"]}
        assert (shown["lab"]["read_only"], shown["lab"]["policy"]) == (True, "")
        assert (shown["yard"]["read_only"], shown["yard"]["policy"]) == (False, "teleop-slow")
        stopped = {one["robot"]: one["stopped"] for one in agent.call("ros2_stop")["robots"]}
        assert (stopped["lab"]["latched"], stopped["yard"]["latched"]) == (False, True)
        latch = StateFolder.of(domain_id=robots["yard"], env=ros_environment).latch()
        latch.reset(by="operator", seen=latch.look().count)
