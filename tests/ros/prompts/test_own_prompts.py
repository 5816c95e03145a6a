"""The user's own prompts, and completions, over real stdio."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from support.agent import FULL, until
from support.prompting import PromptAgent
from support.raw_server import MODERN, RawServer
from support.standstill import undisturbed

HOW_TO = Path(__file__).parents[3] / "docs/how-to/prompts.md"
RELAY, HEALTH = "base.ros2-topic-relay", "base.ros2-node-health-check"
MODULE = "print('hello from user code')\ndef patrol(area: str): return f'Patrol {area}.'\nALL_PROMPTS = [patrol]\n"
HELLO = "---\nname: hello\n---\nHello.\n"


@pytest.mark.promise("README", "add your own as Markdown files")
def test_the_example_of_the_how_to_works_as_written(
    start_agent: Callable[..., PromptAgent], demo_robot: object, tmp_path: Path
) -> None:
    example = re.search(r"^```markdown\n(.*?)^```", HOW_TO.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert example
    (tmp_path / "battery-check.md").write_text(example[1], encoding="utf-8")
    agent = start_agent("--prompts", str(tmp_path))
    agent.agent.knows("/battery_state")
    assert agent.prompts()["battery-check"].arguments[0].name == "topic"
    seconds = "1.5" if FULL else "5"  # it tells its state once a second

    def taken() -> list[Any]:
        return agent.take("battery-check", seconds=seconds)

    battery, rate = undisturbed(taken) if FULL else taken()
    assert 0 < battery["message"]["percentage"] <= 1
    assert rate["topics"][0]["count"] > 0
    assert "seconds cannot be '90'. Give a number from 1 to 30" in agent.refusal("battery-check", seconds="90")
    assert agent.complete("battery-check", "caution", "h") == ["high"]
    until(lambda: agent.complete("battery-check", "topic", "batt") == ["/battery_state"])


@dataclass
class Own:
    """A server with a folder of prompts, and a user's module, which only the option --custom-prompts lets in."""

    server: RawServer
    folder: Path
    capabilities: dict[str, Any]
    is_custom: bool


@pytest.fixture(scope="module", params=[MODERN, "2025-06-18"])
def own(
    request: pytest.FixtureRequest, demo_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Own]:
    folder, modules = tmp_path_factory.mktemp("prompts"), tmp_path_factory.mktemp("modules")
    (folder / "hello.md").write_text(HELLO)
    (folder / "bad.md").write_text("---\nname: x\nargs: []\n---\nHi.\n")
    (modules / "extension_prompts.py").write_text(MODULE)
    is_custom = request.param == MODERN
    options = ("--prompts", str(folder), "--prompts-local", "--prompts-path", str(modules))
    server = RawServer(demo_environment, *options, *(("--custom-prompts",) if is_custom else ()))
    yield Own(server, folder, server.begin(request.param)["capabilities"], is_custom)
    server.end()


def test_a_changed_folder_is_read_again_and_the_client_is_told(own: Own) -> None:
    server = own.server
    assert own.capabilities["prompts"]["listChanged"] is True
    if server.version == MODERN:
        server.send("subscriptions/listen", notifications={"promptsListChanged": True})
        _wait_for(server, "notifications/subscriptions/acknowledged")
    assert "hello" in _names(server)
    (own.folder / "bye.md").write_text(HELLO.replace("hello", "bye"))
    assert server.ask("prompts/get", name="bye")["result"]["messages"][0]["content"]["text"] == "Hello."
    _wait_for(server, "notifications/prompts/list_changed")
    assert {"hello", "bye"} <= set(_names(server))
    server.errors.seek(0)
    assert f"{own.folder / 'bad.md'}:3: 'args' means nothing here." in server.errors.read().decode()


def test_prompts_of_a_users_module_are_offered_where_asked_for_and_its_prints_stay_off_the_protocol(own: Own) -> None:
    assert ("patrol" in _names(own.server)) == own.is_custom
    if own.is_custom:
        got = own.server.ask("prompts/get", name="patrol", arguments={"area": "the yard"})
        assert got["result"]["messages"][0]["content"]["text"] == "Patrol the yard."
    assert b"hello from user code" not in own.server.said


def test_completions_are_the_live_names(agent: PromptAgent) -> None:
    until(lambda: agent.complete(RELAY, "source_topic", "/od") == ["/odom"])
    until(lambda: agent.complete(RELAY, "message_type", source_topic="scan")[:1] == ["sensor_msgs/msg/LaserScan"])
    twist = "geometry_msgs/msg/Twist"
    until(lambda: agent.complete(RELAY, "message_type", twist)[:1] == [twist])
    until(lambda: len(agent.complete(RELAY, "message_type")) == 100)
    until(lambda: "/scan, /odom" in agent.complete(HEALTH, "expected_topics", "/scan, od"))
    assert "/scan, /scan" not in agent.complete(HEALTH, "expected_topics", "/scan, sc")
    assert agent.complete(HEALTH, "check_rates", "t") == ["true"]
    assert agent.complete("no-such-prompt", "x") == []


@pytest.mark.full
def test_completions_are_quick(agent: PromptAgent) -> None:
    agent.agent.call("ros2_topic_list")  # waits until discovery has settled

    def seconds() -> float:
        started = time.perf_counter()
        assert agent.complete(RELAY, "source_topic", "/od") == ["/odom"]
        return time.perf_counter() - started

    elapsed = undisturbed(seconds)
    assert elapsed < 0.25  # 50 ms on an idle machine
    print(f"completion took {elapsed * 1000:.1f} ms")


@pytest.mark.parametrize(
    ("template", "variable", "typed", "first"),
    [
        ("ros2://topic/{+name}", "name", "sca", "/scan"),
        ("ros2://node/{+name}/parameters", "name", "lid", "/lidar"),
        ("ros2://interface/{+type}", "type", "std_msgs/msg/Str", "std_msgs/msg/String"),
    ],
)
def test_variables_of_resource_templates_are_completed(
    agent: PromptAgent, template: str, variable: str, typed: str, first: str
) -> None:
    until(lambda: agent.complete_uri(template, variable, typed)[:1] == [first])


def test_without_ros_prompts_are_there_and_completions_are_empty(start_raw: Callable[..., RawServer]) -> None:
    server = start_raw("--distro", "none-such")
    server.begin(MODERN)
    assert len(_names(server)) == 5
    _seconds_of_an_empty_completion(server)


@pytest.mark.full
def test_without_ros_completions_are_empty_within_two_seconds(start_raw: Callable[..., RawServer]) -> None:
    server = start_raw("--distro", "none-such")
    server.begin(MODERN)
    assert undisturbed(lambda: _seconds_of_an_empty_completion(server)) < 2


def _seconds_of_an_empty_completion(server: RawServer) -> float:
    ref, argument = {"type": "ref/prompt", "name": RELAY}, {"name": "source_topic", "value": ""}
    started = time.perf_counter()
    assert server.ask("completion/complete", ref=ref, argument=argument)["result"]["completion"]["values"] == []
    return time.perf_counter() - started


def _names(server: RawServer) -> list[str]:
    return [prompt["name"] for prompt in server.ask("prompts/list")["result"]["prompts"]]


def _wait_for(server: RawServer, method: str) -> dict[str, Any]:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        for line in server.lines():
            if line.get("method") == method:
                return line
        server.ask("prompts/list")
    raise AssertionError(f"no {method} in {server.said[-500:]!r}")
