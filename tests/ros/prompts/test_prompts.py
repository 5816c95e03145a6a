"""The base prompts on the simulated robot: their steps are taken as written."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from support.faults import FAULTS
from support.prompting import PromptAgent
from support.standstill import undisturbed

ECHO, RELAY = "base.ros2-topic-echo-and-analyze", "base.ros2-topic-relay"
HEALTH, DIFF = "base.ros2-node-health-check", "base.ros2-topic-diff-monitor"
BOTH_ERAS = pytest.mark.parametrize("mode", ["auto", "legacy"])
SENSORS = "['/imu', '/scan', \"/odom\"]"  # as the prompts of the existing system have it


@BOTH_ERAS
def test_prompts_are_listed_and_fetched_in_both_eras(
    start_agent: Callable[..., PromptAgent], demo_robot: object, mode: str
) -> None:
    agent = start_agent(mode=mode)
    assert list(agent.prompts()) == [ECHO, RELAY, HEALTH, DIFF]
    assert "1. Call ros2_health_check with" in agent.text(HEALTH)
    every = {"topic_name": "/odom", "duration_sec": "2", "analysis_type": "statistics"}
    assert '{"topic_names": ["/odom"], "duration": 2.0}' in agent.text(ECHO, **every)
    assert "analysis_type is 'mean'. Give one of all" in agent.refusal(ECHO, analysis_type="mean")
    assert "needs the argument source_topic" in agent.refusal(RELAY)
    assert "Did you mean base.ros2-topic-relay?" in agent.refusal("base.ros2-topic-relais")
    while "/odom" not in (names := agent.complete(ECHO, "topic_name", "od")):  # discovery has not settled
        time.sleep(0.1)
    assert names[0] == "/odom"


@pytest.mark.promise("README", "the analysis of a topic")
def test_a_topic_is_analyzed_as_the_prompt_says(agent: PromptAgent) -> None:
    statistics, stats = undisturbed(lambda: agent.take(ECHO, topic_name="/odom", duration_sec="1"))
    assert statistics["topics"][0]["count"] > 10
    assert stats["topics"][0]["rate_hz"] > 10


def test_without_a_topic_the_rates_of_all_are_measured(agent: PromptAgent) -> None:
    [stats] = agent.take(ECHO, duration_sec="1")
    assert {"/odom", "/scan"} <= {topic["topic_name"] for topic in stats["topics"]}


@pytest.mark.promise("README", "a relay;")
@pytest.mark.promise("ros2_relay_stop", "Stop a relay")
def test_a_relay_works_as_the_prompt_says(agent: PromptAgent) -> None:
    given = {"source_topic": "/odom", "destination_topic": "/odom_slow", "transform": "rate_limit"}

    def measured() -> float | None:
        started, stats, relays = agent.take(RELAY, **given, target_rate_hz="5", duration_sec="20")
        assert started["relay_id"] in str(relays)
        agent.agent.call("ros2_relay_stop", relay_id=started["relay_id"])
        return stats["topics"][1]["rate_hz"]

    assert undisturbed(measured) == pytest.approx(5, rel=0.2)


@pytest.mark.promise("README", "the comparison of two")
def test_a_topic_and_its_relay_are_compared(agent: PromptAgent) -> None:
    relay = agent.agent.call("ros2_relay_start", source_topic="/odom", destination_topic="/odom_same")
    [same, *_] = undisturbed(lambda: agent.take(DIFF, topic1_name="/odom", topic2_name="/odom_same", duration_sec="1"))
    agent.agent.call("ros2_relay_stop", relay_id=relay["relay_id"])
    assert same["verdict"] == "IDENTICAL"


@pytest.mark.promise("README", "Prompts lead the agent through whole jobs with the default tools: a health check")
@pytest.mark.parametrize(
    ("fault", "verdicts", "said"),
    [
        ("none", {"HEALTHY"}, ""),
        ("dead", {"DEGRADED", "CRITICAL"}, "/imu"),
        ("slow", {"DEGRADED", "CRITICAL"}, "/scan"),
        ("qos", {"DEGRADED", "CRITICAL"}, "/imu"),
    ],
)
def test_the_health_check_names_what_is_wrong(
    agent: PromptAgent, demo_environment: dict[str, str], fault: str, verdicts: set[str], said: str
) -> None:
    asked = {"expected_topics": SENSORS, "min_expected_rate_hz": "3", "rate_check_duration_sec": "1.5"}
    with FAULTS[fault](agent, demo_environment):
        [health] = undisturbed(lambda: agent.take(HEALTH, **asked))
    assert health["verdict"] in verdicts, health
    assert said in "".join(finding["subject"] + finding["problem"] for finding in health["findings"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--tools", "core,measure"), "because the option --tools core,measure,relay is needed"),
        (("--read-only", "--tools", "all"), "because this server is read-only"),
    ],
)
def test_a_prompt_that_is_not_possible_says_why(
    start_agent: Callable[..., PromptAgent], options: tuple[str, ...], said: str
) -> None:
    agent = start_agent(*options)
    assert said in agent.text(RELAY, source_topic="/a", destination_topic="/b")
