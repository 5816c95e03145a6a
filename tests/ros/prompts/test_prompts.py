"""The base prompts on the simulated robot: their steps are taken as written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from support.agent import FULL, until
from support.faults import FAULTS
from support.prompting import PromptAgent
from support.standstill import undisturbed

PATIENCE_S = 60.0
ECHO, RELAY = "base.ros2-topic-echo-and-analyze", "base.ros2-topic-relay"
HEALTH, DIFF = "base.ros2-node-health-check", "base.ros2-topic-diff-monitor"
NAVIGATION = "base.ros2-navigation-check"
BOTH_ERAS = pytest.mark.parametrize("mode", ["auto", "legacy"])
SENSORS = "['/imu', '/scan', \"/odom\"]"  # as the prompts of the existing system have it


@BOTH_ERAS
def test_prompts_are_listed_and_fetched_in_both_eras(
    agent: PromptAgent, start_agent: Callable[..., PromptAgent], mode: str
) -> None:
    agent = start_agent(mode=mode) if mode == "legacy" else agent
    assert list(agent.prompts()) == [ECHO, RELAY, HEALTH, DIFF, NAVIGATION]
    assert "1. Call ros2_health_check with" in agent.text(HEALTH)
    every = {"topic_name": "/odom", "duration_sec": "2", "analysis_type": "statistics"}
    assert '{"topic_names": ["/odom"], "duration_s": 2.0}' in agent.text(ECHO, **every)
    assert "analysis_type cannot be 'mean'. Give one of all" in agent.refusal(ECHO, analysis_type="mean")
    assert "needs the argument source_topic" in agent.refusal(RELAY)
    assert "Did you mean base.ros2-topic-relay?" in agent.refusal("base.ros2-topic-relais")
    until(lambda: agent.complete(ECHO, "topic_name", "od")[:1] == ["/odom"])


@pytest.mark.promise("README", "the analysis of a topic")
def test_a_topic_is_analyzed_as_the_prompt_says(agent: PromptAgent) -> None:
    def is_measured() -> bool:
        statistics, stats = agent.take(ECHO, topic_name="/odom", duration_sec="1")
        return statistics["topics"][0]["count"] > 10 and stats["topics"][0]["rate_hz"] > 0

    until(is_measured, PATIENCE_S)  # at most 25 messages come, fewer where the machine is busy


@pytest.mark.full
def test_the_rate_of_a_topic_is_measured_as_the_prompt_says(agent: PromptAgent) -> None:
    statistics, stats = undisturbed(lambda: agent.take(ECHO, topic_name="/odom", duration_sec="1"))
    assert statistics["topics"][0]["count"] > 10
    assert stats["topics"][0]["rate_hz"] > 10


def test_without_a_topic_the_rates_of_all_are_measured(agent: PromptAgent) -> None:
    [stats] = agent.take(ECHO, duration_sec="1")
    assert {"/odom", "/scan"} <= {topic["topic_name"] for topic in stats["topics"]}


@pytest.mark.promise("README", "a relay;")
@pytest.mark.promise("ros2_relay_stop", "Stop a relay")
def test_a_relay_works_as_the_prompt_says(agent: PromptAgent) -> None:
    def works() -> bool:
        """Measured while a busy machine has let the relay's topic be known."""
        rate_hz, relay = relayed(agent)
        return bool(rate_hz and relay["published"] and relay["filtered_out"])

    until(works, PATIENCE_S)


@pytest.mark.full
def test_the_rate_of_a_relay_is_as_the_prompt_says(agent: PromptAgent) -> None:
    assert undisturbed(lambda: relayed(agent)[0]) == pytest.approx(5, rel=0.2)


def relayed(agent: PromptAgent) -> tuple[float | None, dict[str, Any]]:
    """The measured rate of a relay that passes 5 Hz of /odom's 20, and its counters."""
    given = {"source_topic": "/odom", "destination_topic": "/odom_slow", "transform": "rate_limit"}
    started, stats, relays = agent.take(RELAY, **given, target_rate_hz="5", duration_sec="20")
    assert started["relay_id"] in str(relays)
    return stats["topics"][1]["rate_hz"], agent.agent.call("ros2_relay_stop", relay_id=started["relay_id"])


@pytest.mark.promise("README", "the comparison of two")
def test_a_topic_and_its_relay_are_compared(agent: PromptAgent) -> None:
    relay = agent.agent.call("ros2_relay_start", source_topic="/odom", destination_topic="/odom_same")
    asked = {"topic1_name": "/odom", "topic2_name": "/odom_same", "duration_sec": "1"}
    first_look(lambda: agent.take(DIFF, **asked)[0]["verdict"] == "IDENTICAL")
    agent.agent.call("ros2_relay_stop", relay_id=relay["relay_id"])


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

    def is_told() -> bool:
        """Of rates that a busy machine has not stretched."""
        [health] = agent.take(HEALTH, **asked)
        found = "".join(finding["subject"] + finding["problem"] for finding in health["findings"])
        return health["verdict"] in verdicts and said in found

    with FAULTS[fault](agent, demo_environment):
        first_look(is_told)


def first_look(is_so: Callable[[], bool]) -> None:
    """It is so: in full at the first look, in CI as soon as a busy machine lets it be."""
    if FULL:
        assert undisturbed(is_so)
    until(is_so, PATIENCE_S)


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
