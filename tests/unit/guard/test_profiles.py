"""The profiles: each decides as its table says, and says in words what it decides by."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.guard import trials, words
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.policy_file import PROFILES, compiled, read_policy

TABLES = Path(__file__).parent / "profiles"
LIMITING = ("norm", "range", "one_of", "count", "pace")


def policy_of(which: str) -> Policy:
    document = read_policy(which)
    return Policy(documents=(document,), rules=compiled([document]))


@pytest.mark.promise("README", "says what the agent may do")
@pytest.mark.promise("README", "everything else is refused, whatever the model was talked into")
def test_each_profile_decides_every_command_as_its_table_says() -> None:
    wrong: list[str] = []
    for table in sorted(TABLES.glob("*.csv")):
        policy, rows = policy_of(table.stem), list(trials.rows_of(table))
        assert len(rows) >= 120, table
        for row in rows:
            decision = trials.decided(policy, row.trial)
            if trials.DECISIONS[decision.verdict] != row.expected:
                wrong.append(f"{table.name}:{row.line}: {row.trial} is {decision}, not {row.expected}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_a_profile_says_every_bound_that_it_has_in_words(profile: str) -> None:
    rules = read_policy(profile).rules
    text = "\n".join([*words.allowed(rules), *words.limits(rules), *words.forbidden(rules)])
    for number in _numbers(read_policy(profile).form):
        assert re.search(rf"(?<![\d.]){re.escape(f'{number:g}')}(?![\d.]*\d)", text), (number, text)


def _numbers(form: Any) -> Iterator[float]:
    """Every bound in the canonical form of a policy, whatever it is called."""
    if isinstance(form, dict):
        for key, value in form.items():
            if key not in ("policy", "consent", "audit", "feedback"):
                yield from _numbers(value)
    elif isinstance(form, (list, tuple)):
        for value in form:
            yield from _numbers(value)
    elif isinstance(form, (int, float)) and not isinstance(form, bool):
        yield form


@pytest.mark.parametrize(
    ("profile", "trial", "verdict"),
    [
        ("observe", {"verb": "publish", "name": "/cmd_vel", "type": "geometry_msgs/msg/Twist"}, "refused"),
        ("teleop-slow", {"value": {"linear": {"x": 0.2}}}, "allowed"),
        ("teleop-slow", {"value": {"linear": {"x": 0.21}}}, "refused"),
        ("teleop-slow", {"value": {"linear": {"x": 0.15, "y": 0.15}}}, "refused"),
        ("teleop-slow", {"name": "/robot1/cmd_vel", "value": {"angular": {"z": 0.5}}}, "allowed"),
        ("teleop-slow", {"name": "/cmd_vel_nav"}, "refused"),
        ("teleop-slow", {"value": {"linear": {"x": float("nan")}}}, "refused"),
        ("teleop-slow", {"publishers": ("/controller_server",)}, "refused"),
        ("teleop-slow", {"rate_hz": 50.0, "duration_s": 10.0}, "allowed"),
        ("teleop-slow", {"rate_hz": 50.0, "duration_s": 10.5}, "refused"),
        ("teleop-slow", {"rate_hz": 51.0, "duration_s": 1.0}, "refused"),
        ("teleop-slow", {"rate_hz": 10.0, "duration_s": 0.0}, "refused"),
        ("teleop-slow", {"verb": "relay"}, "refused"),
        (
            "teleop-slow",
            {"type": "geometry_msgs/msg/TwistStamped", "value": {"twist": {"linear": {"x": 0.2}}}},
            "allowed",
        ),
        (
            "teleop-slow",
            {"type": "geometry_msgs/msg/TwistStamped", "value": {"twist": {"linear": {"x": 0.3}}}},
            "refused",
        ),
        ("teleop-slow", {"verb": "call", "name": "/x", "type": "std_srvs/srv/Trigger"}, "refused"),
        ("teleop-slow", {"verb": "call", "name": "/x", "type": "rcl_interfaces/srv/GetParameters"}, "allowed"),
        ("teleop-slow", {"verb": "set", "name": "/base", "value": {"a": 1}}, "refused"),
        ("teleop-slow", {"verb": "record", "name": "/scan /odom"}, "allowed"),
        ("teleop-slow", {"verb": "cancel", "name": "/go", "own": True}, "allowed"),
        ("teleop-slow", {"verb": "cancel", "name": "/go"}, "refused"),
        ("lab", {"verb": "set", "name": "/base", "value": {"a": 1}}, "consent"),
        ("lab", {"verb": "call", "name": "/x", "type": "composition_interfaces/srv/LoadNode"}, "refused"),
        ("lab", {"verb": "call", "name": "/x", "type": "nav2_msgs/srv/Toggle"}, "consent"),
        ("lab", {"verb": "call", "name": "/x", "type": "std_srvs/srv/Trigger"}, "allowed"),
        ("lab", {"publishers": ("/controller_server",)}, "allowed"),
        ("lab", {"value": {"linear": {"x": 1.1}}}, "refused"),
    ],
)
def test_what_a_profile_decides(profile: str, trial: dict[str, Any], verdict: str) -> None:
    usual: dict[str, Any] = {"verb": "publish", "name": "/cmd_vel", "type": "geometry_msgs/msg/Twist"}
    decision = trials.decided(policy_of(profile), trials.Trial(**(usual | trial)))
    assert decision.verdict == verdict, decision
