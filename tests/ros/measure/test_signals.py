"""What the tools measure of real messages, against what was published and against NumPy."""

from __future__ import annotations

import json
import re
import subprocess
from typing import Any

import numpy as np
import pytest

from support.agent import CALL_S, Agent, until
from support.standstill import undisturbed

GAP = re.compile(r"nothing for (\S+) s from (\S+) s \(\S+\) on")
GAPS = {"topic_names": ["/signal"], "duration": 4.5}
REPLAYS = {"topic_names": ["/settings"], "duration": 4}
HELD = ("/signal_steady", "/signal_copy", "/pulse", "/signal", "/sensor", "/signal_wave", "/signal_late")


def published(signals: subprocess.Popen[str]) -> dict[str, Any]:
    assert signals.stdin
    assert signals.stdout
    signals.stdin.write("dump\n")
    signals.stdin.flush()
    return {name: np.array(sent) for name, sent in json.loads(signals.stdout.readline()).items()}


@pytest.mark.promise("ros2_topic_statistics", "Measure numeric fields of topics")
@pytest.mark.promise("ros2_topic_statistics", "min, max, mean, std")
@pytest.mark.full
def test_the_numbers_are_those_of_the_published_messages(agent: Agent, signals: subprocess.Popen[str]) -> None:
    (topic,) = agent.call("ros2_topic_statistics", topic_names=["/signal_steady"], duration_s=3)["topics"]
    fields = {field["field"]: field for field in topic["fields"]}
    first, last = int(fields["point.z"]["first"]), int(fields["point.z"]["last"])
    assert topic["count"] == last - first + 1 == pytest.approx(150, abs=5)
    assert topic["dropped"] == 0
    x, y, _ = published(signals)["signal_steady"][first : last + 1].T
    for name, truth in (("point.x", x), ("point.y", y)):
        field = fields[name]
        assert [field["min"], field["max"]] == [truth.min(), truth.max()]
        assert [field["first"], field["last"]] == [truth[0], truth[-1]]
        assert field["mean"] == pytest.approx(truth.mean(), rel=1e-12)
        assert field["std"] == pytest.approx(truth.std(), rel=1e-9)
    assert fields["point.x"]["slope"] == pytest.approx(0.4, rel=0.02)
    assert topic["rate_hz"] == pytest.approx(50.0, rel=0.03)
    assert topic["gaps"] == []


def measured(agent: Agent) -> dict[str, dict[str, Any]]:
    """What several calls at the same time give, each as if it were alone.

    Their subscriptions, which are shared, are there and matched before: on a busy machine one may be so seconds later
    than another, and a measurement waits for that half a second only.
    """
    asked = {"duration": 50, "message_limit": 100_000}
    held = [agent.begin("ros2_topic_subscribe", topic_name=topic, **asked) for topic in HELD]
    try:
        for topic in HELD:
            agent.call("ros2_topic_subscribe", topic_name=topic, message_limit=2)
        return measured_together(agent)
    finally:
        for call in held:
            call.cancel()


def measured_together(agent: Agent) -> dict[str, dict[str, Any]]:
    calls = {
        "together": ("statistics", {"topic_names": ["/signal_steady", "/signal_copy", "/pulse"], "duration": 2}),
        "twice": ("statistics", {"topic_names": ["/signal_steady", "signal_steady"], "duration": 2}),
        "gaps": ("statistics", GAPS),
        "faults": ("statistics", {"topic_names": ["/sensor"], "duration": 5, "fields": ["range"]}),
        "replay": ("stats", REPLAYS),
        "replay, values": ("statistics", REPLAYS),
        "late": ("compare", {"topic1_name": "/signal_wave", "topic2_name": "/signal_late", "duration_sec": 4}),
        "copy": ("compare", {"topic1_name": "/signal_steady", "topic2_name": "/signal_copy", "duration_sec": 2}),
    }
    begun = {name: agent.begin(f"ros2_topic_{tool}", **arguments) for name, (tool, arguments) in calls.items()}
    return {name: call.result(CALL_S) for name, call in begun.items()}


@pytest.fixture(scope="module")
def results(agent: Agent, signals: subprocess.Popen[str]) -> dict[str, dict[str, Any]]:
    return measured(agent)


@pytest.mark.full
def test_rates_gaps_and_delays_are_right(agent: Agent, signals: subprocess.Popen[str]) -> None:
    """What is measured in time; the other tests judge by the counters that messages have."""
    results = undisturbed(lambda: measured(agent))
    twice = [topic["count"] for topic in results["twice"]["topics"]]
    assert twice[0] == pytest.approx(twice[1], abs=2)
    steady, _, pulse = results["together"]["topics"]
    assert pulse["count"] == pytest.approx(4 * steady["count"], rel=0.05)
    periods, injected, inner = gaps(results, signals)
    assert inner == pytest.approx(list(injected), abs=0.06)
    (topic,) = results["gaps"]["topics"]
    assert topic["period_median_s"] == pytest.approx(np.median(periods), rel=0.1)
    (flow,) = results["replay"]["topics"]
    assert 1 < flow["count"] <= 6 * REPLAYS["duration"]
    assert flow["rate_hz"] <= 6 and flow["bytes_per_second"] <= 12 * 6
    (values,) = results["replay, values"]["topics"]
    assert values["rate_hz"] <= 6
    assert results["late"]["delay_s"] == pytest.approx(0.2, abs=0.02)
    assert results["late"]["fields"][0]["mean_difference"] == pytest.approx(1.0, abs=0.3)


def test_a_topic_that_is_named_twice_is_counted_once_each_time(results: dict[str, dict[str, Any]]) -> None:
    topics = results["twice"]["topics"]
    counters = [next(field for field in topic["fields"] if field["field"] == "point.z") for topic in topics]
    assert [topic["count"] for topic in topics] == [field["last"] - field["first"] + 1 for field in counters]


@pytest.mark.promise("ros2_topic_statistics", "at the same time")
def test_several_topics_are_measured_over_the_same_time(results: dict[str, dict[str, Any]]) -> None:
    steady, copy, pulse = results["together"]["topics"]
    assert steady["started_at"] == copy["started_at"] == pulse["started_at"]
    counters = [
        [(f["first"], f["last"]) for f in topic["fields"] if f["field"] == "point.z"] for topic in (steady, copy)
    ]
    assert np.abs(np.subtract(*counters)).max() <= 1
    assert pulse["count"] > 0


def gaps(results: dict[str, dict[str, Any]], signals: subprocess.Popen[str]) -> tuple[Any, Any, list[float]]:
    """The periods in which it was published, those of them that are gaps, and the gaps that were found, in s: those
    between two messages; the window may begin or end in another one.
    """
    (topic,) = results["gaps"]["topics"]
    number = next(field for field in topic["fields"] if field["field"] == "point.z")
    at = published(signals)["signal"][int(number["first"]) : int(number["last"]) + 1, 0] / 0.4
    periods = np.diff(at)
    injected = periods[periods > 0.3]
    assert len(injected) >= 2
    found = [(float(begin), float(duration)) for duration, begin in GAP.findall("\n".join(topic["gaps"]))]
    is_inner = [begin > 0.0 and begin + duration < topic["duration"] - 0.001 for begin, duration in found]
    inner = [duration for (_, duration), inside in zip(found, is_inner, strict=True) if inside and duration > 0.3]
    return periods, injected, inner


@pytest.mark.promise("ros2_topic_statistics", "gaps")
def test_injected_gaps_are_found(
    agent: Agent, results: dict[str, dict[str, Any]], signals: subprocess.Popen[str]
) -> None:
    """All of them; a busy machine may make more. Where it receives the message before a gap late, that gap is shorter:
    then it is measured again.
    """

    def all_found(measured: dict[str, dict[str, Any]]) -> bool:
        _, injected, inner = gaps(measured, signals)
        return len(inner) >= len(injected)

    assert all_found(results) or until(lambda: all_found({"gaps": agent.call("ros2_topic_statistics", **GAPS)}))


@pytest.mark.promise("ros2_topic_statistics", "stuck values, NaN")
def test_a_stuck_and_faulty_sensor_is_told(results: dict[str, dict[str, Any]]) -> None:
    (topic,) = results["faults"]["topics"]
    (sensor,) = topic["fields"]
    assert any(line.startswith("stuck at") for line in sensor["anomalies"])
    assert abs(sensor["not_finite"] - topic["count"] / 50) < 1


def test_replayed_history_is_in_no_rate(results: dict[str, dict[str, Any]]) -> None:
    (flow,) = results["replay"]["topics"]
    assert flow["replayed"] >= 50 and 0 < flow["count"] < 50
    assert flow["rate_hz"] < flow["replayed"] / REPLAYS["duration"]
    assert flow["publisher_nodes"] == ["/signals"]
    (values,) = results["replay, values"]["topics"]
    assert values["count"] > 50 and values["rate_hz"] < 50 / REPLAYS["duration"]


@pytest.mark.promise(
    "ros2_topic_compare", "Compare two topics over the same time, field by field: differences, correlation, delay"
)
def test_a_known_delay_and_offset_are_found(results: dict[str, dict[str, Any]]) -> None:
    found = results["late"]
    assert found["delay_s"] > 0 and found["fields"][0]["mean_difference"] > 0
    assert found["verdict"] in ("DIFFERENT", "VERY DIFFERENT")
    assert found["paired_by"] == "nearest time of receipt: not both topics have a header"


@pytest.mark.promise("ros2_topic_compare", "The verdict is IDENTICAL, SIMILAR, DIFFERENT or VERY DIFFERENT")
def test_a_copy_is_identical(results: dict[str, dict[str, Any]]) -> None:
    found = results["copy"]
    assert (found["verdict"], found["paired_by"]) == ("IDENTICAL", "stamp")
    assert found["equal_messages"] == found["pairs"] >= max(found["count1"], found["count2"]) - 2 > 10


@pytest.mark.promise("ros2_wait_until", "Every message is checked")
def test_a_short_pulse_is_not_missed(agent: Agent, signals: subprocess.Popen[str]) -> None:
    """One message in 100 is one."""
    for _ in range(3):
        found = agent.call("ros2_wait_until", topic_name="/pulse", condition="data > 5", timeout_s=50)
        assert found["met"] and found["message"] == {"data": 7.0}
        assert found["messages_checked"] <= 100 and not found["dropped"]


def test_what_never_comes_ends_with_the_last_seen(agent: Agent, signals: subprocess.Popen[str]) -> None:
    def waited() -> dict[str, Any] | None:
        found = agent.call("ros2_wait_until", topic_name="/pulse", condition="data < 0", timeout_s=1)
        return found if found["message"] is not None else None  # matching may take that second on a busy machine

    found = until(waited)
    assert not found["met"]
    assert found["messages_checked"] > 0 and found["waited"] >= 1.0


@pytest.mark.full
def test_a_pulse_is_told_at_once_and_what_never_comes_when_its_time_is_over(
    agent: Agent, signals: subprocess.Popen[str]
) -> None:
    asked = {"topic_name": "/pulse", "condition": "data > 5", "timeout": 20}
    for _ in range(3):
        found = undisturbed(lambda: agent.call("ros2_wait_until", **asked))
        assert found["waited"] < 1.5
    asked = {"topic_name": "/pulse", "condition": "data < 0", "timeout": 1}
    found = undisturbed(lambda: agent.call("ros2_wait_until", **asked))
    assert found["messages_checked"] == pytest.approx(200, abs=60)
    assert found["waited"] == pytest.approx(1.0, abs=0.3)


def test_a_bad_field_is_refused_at_once(agent: Agent, signals: subprocess.Popen[str]) -> None:
    refusal = agent.refusal("ros2_wait_until", topic_name="/signal", condition="piont.x > 1", timeout_s=50)
    assert "Did you mean point?" in refusal
