"""The guard with consent and audit: in which mode a person is asked, and what is written down."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, cast

import pytest

from ros2_mcp.guard.audit_file import KEEP_BYTES
from ros2_mcp.guard.chain import entries, verify
from ros2_mcp.guard.consent import AUDIT, Auditing, Consent, with_consent
from ros2_mcp.guard.document import Document
from ros2_mcp.guard.guard import Guard
from ros2_mcp.guard.policy import Facts, Policy
from ros2_mcp.guard.policy_file import compiled, document_of
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import LOCAL, Publish
from ros2_mcp.model.errors import ApprovalNeeded, Refused
from ros2_mcp.model.qos import Choice, QoS
from ros2_mcp.ops.topics.publish import PublishRequest, publish_several
from ros2_mcp.robot import Robot
from support.noting_bridge import Noting

TWIST = "geometry_msgs/msg/Twist"
RULES = """
policy: 1
mode: {mode}
consent: {{valid_s: 30, grants_s: 100}}
allow:
  - {{publish: /cmd_vel, type: geometry_msgs/msg/Twist}}
  - {{publish: /asked, type: geometry_msgs/msg/Twist, consent: each}}
  - {{publish: /free, type: geometry_msgs/msg/Twist, consent: never}}
  - {{publish: /slow, type: geometry_msgs/msg/Twist, rate_hz: 5, fields: {{linear.x: {{range: [0, 0.2]}}}}}}
  - {{publish: /several, type: geometry_msgs/msg/Twist, consent: each}}
  - {{publish: /several, type: geometry_msgs/msg/Twist, fields: {{linear.x: {{range: [0, 0.1]}}}}, consent: never}}
limits:
  base: {{types: [geometry_msgs/msg/Twist], names: [/slow], norm: {{angular: 0.5}}}}
"""


def guarded(folder: Path, mode: str) -> tuple[Guard, Consent, Auditing]:
    """A guard under a policy of that mode."""
    document = document_of(RULES.format(mode=mode), "a test")
    guard = Guard(Policy(documents=(document,), rules=compiled([document])))
    consent = with_consent(guard, StateFolder(folder), lambda: "0.0")
    assert isinstance(guard.audit, Auditing)
    return guard, consent, guard.audit


async def publish(guard: Guard, name: str, x: float = 0.1) -> None:
    """What `Robot.do` does with one message."""
    given: dict[str, Any] = {"principal": LOCAL, "name": name, "type": TWIST, "value": {"linear": {"x": x}}}
    command = Publish(choice=Choice(QoS("reliable", "volatile", depth=1), ""), wait_match_s=1.0, **given)

    async def facts(*_: Any) -> Facts:
        zero = {"x": 0.0, "y": 0.0, "z": 0.0}
        return Facts(value={"linear": {**zero, "x": x}, "angular": zero})

    async with guard.acting(command, facts):
        pass


def run(folder: Path, mode: str, work: Callable[[Guard, Consent], Awaitable[None]]) -> list[tuple[str, str]]:
    """Does the work; the kinds and the outcomes of the lines of its audit."""
    guard, consent, auditing = guarded(folder, mode)
    asyncio.run(_all(work(guard, consent)))
    auditing.log.close()
    assert verify(folder / AUDIT).faults == []
    return [(entry["kind"], entry.get("outcome", "")) for entry in entries(folder / AUDIT)]


async def _all(work: Awaitable[None]) -> None:
    await work


def test_in_confirm_everything_waits_but_what_a_rule_frees(tmp_path: Path) -> None:
    async def work(guard: Guard, consent: Consent) -> None:
        await publish(guard, "/free")
        for name in ("/cmd_vel", "/asked"):
            with pytest.raises(ApprovalNeeded) as needed:
                await publish(guard, name)
            consent.approvals.approve(needed.value.request_id, by="operator ann")
            with pytest.raises(ApprovalNeeded):
                await publish(guard, name, 0.10000000000000002)
            await publish(guard, name)
            with pytest.raises(ApprovalNeeded):
                await publish(guard, name)

    lines = run(tmp_path, "confirm", work)
    round_of_one = ["asked", "waits", "approved", "asked", "waits", "act", "outcome", "asked", "waits"]
    assert [kind for kind, _ in lines] == ["act", "outcome", *round_of_one, *round_of_one]
    first = next(entry for entry in entries(tmp_path / AUDIT) if entry.get("approval") and entry["kind"] == "act")
    assert first["value"]["angular"] == {"x": 0.0, "y": 0.0, "z": 0.0}  # decoded in full: not what the model wrote
    assert first["decision"] == "consent"
    assert first["policy"]


def test_autonomous_asks_only_where_a_rule_says_so_and_observe_lets_nothing_act(tmp_path: Path) -> None:
    async def work(guard: Guard, consent: Consent) -> None:
        await publish(guard, "/cmd_vel")
        with pytest.raises(ApprovalNeeded):
            await publish(guard, "/asked")
        consent.modes.set("observe")
        for name in ("/cmd_vel", "/asked", "/free"):
            with pytest.raises(Refused) as refused:
                await publish(guard, name)
            assert not isinstance(refused.value, ApprovalNeeded)

    run(tmp_path, "autonomous", work)


def test_a_person_reads_what_the_policy_bounds_of_what_waits(tmp_path: Path) -> None:
    async def work(guard: Guard, consent: Consent) -> None:
        for name in ("/cmd_vel", "/slow"):
            with pytest.raises(ApprovalNeeded):
                await publish(guard, name)
        free, slow = (request.summary() for request in consent.approvals.waiting())
        assert free[2] == "The policy bounds nothing of it."
        assert slow[2] == (
            "The policy bounds at most 5 Hz; linear.x from 0 to 0.2 m/s; "
            "the length of angular at most 0.5 rad/s (29 °/s)."
        )

    run(tmp_path, "confirm", work)


def test_of_several_rules_that_fit_the_one_counts_that_asks_least(tmp_path: Path) -> None:
    async def work(guard: Guard, _: Consent) -> None:
        await publish(guard, "/several", 0.1)
        with pytest.raises(ApprovalNeeded):
            await publish(guard, "/several", 0.11)

    run(tmp_path, "confirm", work)


async def test_of_several_topics_each_says_what_it_waits_for_and_what_is_done_is_not_to_be_done_again(
    tmp_path: Path,
) -> None:
    guard, consent, auditing = guarded(tmp_path, "confirm")
    robot = Robot(cast("Bridge", Noting()), guard)

    async def publish_on(*topics: str) -> list[str]:
        data = {"linear": {"x": 0.1}}
        requests = [PublishRequest(topic_name=topic, message_type=TWIST, data=data) for topic in topics]
        return [one.error for one in (await publish_several(robot, robot.session(), requests)).topics]

    free, asked = await publish_on("/free", "/asked")
    [request] = consent.approvals.waiting()
    assert (
        free == ""
        and f"needs_approval {request.id}" in asked
        and "If a part of it has already succeeded, leave that part out" in asked
    )
    consent.approvals.approve(request.id, by="operator ann")
    assert await publish_on("/asked") == [""]
    robot.failsafes.close()
    auditing.log.close()


def test_a_grant_never_allows_what_the_policy_does_not(tmp_path: Path) -> None:
    async def work(guard: Guard, consent: Consent) -> None:
        with pytest.raises(ApprovalNeeded) as needed:
            await publish(guard, "/cmd_vel")
        consent.approvals.grant(needed.value.request_id, 100, by="operator ann")
        await publish(guard, "/cmd_vel", 0.7)
        with pytest.raises(Refused):
            await publish(guard, "/elsewhere")

    run(tmp_path, "confirm", work)


def test_an_act_that_cannot_be_written_down_is_not_done(tmp_path: Path) -> None:
    async def work(guard: Guard, consent: Consent) -> None:
        head = guard.audit
        assert isinstance(head, Auditing)
        await publish(guard, "/free")
        await head.log.written()  # the line of the outcome, for which nobody waits
        for path in (tmp_path / AUDIT).iterdir():
            path.unlink()
        (tmp_path / AUDIT / "audit.head").mkdir()
        (tmp_path / AUDIT / "audit-000000000003.jsonl").mkdir()
        (tmp_path / AUDIT).chmod(0o500)
        head.log._file.close()  # type: ignore[union-attr]  # pyright: ignore
        with pytest.raises(Refused, match="audit cannot be written"):
            await publish(guard, "/free")

    guard, consent, auditing = guarded(tmp_path, "confirm")
    asyncio.run(_all(work(guard, consent)))
    auditing.log.close()


def test_a_policy_that_is_added_never_shortens_the_audit(tmp_path: Path) -> None:
    long, short, silent = (
        document_of(f"policy: 1\nname: n{text}", "a test")
        for text in ("\naudit: {keep_mb: 20}", "\naudit: {keep_mb: 1}", "")
    )

    def size_of(*documents: Document) -> int:
        guard = Guard(Policy(documents=documents, rules=compiled(documents)))
        with_consent(guard, StateFolder(tmp_path), lambda: "0.0")
        assert isinstance(guard.audit, Auditing)
        return guard.audit.log.keep_bytes

    assert (size_of(long, short, silent), size_of(short, silent), size_of(silent)) == (20e6, 1e6, KEEP_BYTES)
