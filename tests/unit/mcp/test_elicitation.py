"""Approvals by elicitation: both protocol eras ask the client's user, once, and only where the policy accepts that.

The command is a recording, which is decided about and sends nothing: so it needs no robot.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import anyio
import pytest
from mcp import Client
from mcp.types import ElicitRequestParams, ElicitResult

from ros2_mcp.compose.server import assemble
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import Record
from ros2_mcp.model.errors import RosNotFound
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.settings import Settings

_DONE = "It was carried out."
POLICY = """
policy: 1
name: asks
mode: confirm
state: {folder}/state
consent: {{how: {how}}}
allow:
  - {{record: "/**"}}
"""


async def no_robot() -> Any:
    raise RosNotFound("There is no robot here.")


def settings(folder: Path, how: str) -> Settings:
    file = folder / "policy.yaml"
    file.write_text(POLICY.format(folder=folder, how=how))
    file.chmod(0o600)
    return Settings(policy=(str(file),), tools=("all",), record_dir=folder / "recordings")


async def outcomes(folder: Path, mode: Any, how: str, answer: ElicitResult, monkeypatch: Any) -> tuple[list[str], int]:
    """The texts of two equal calls, and how often the user was asked."""
    questions: list[str] = []
    done: list[str] = []

    async def ask(context: Any, params: ElicitRequestParams) -> ElicitResult:
        assert context
        questions.append(params.message)
        return answer

    async def start(robot: Robot, session: Session, *_: Any) -> Any:
        await robot.do(Record(principal=session.principal, name="incident", topics=()), session)
        done.append("done")
        raise RosNotFound(_DONE)

    monkeypatch.setattr("ros2_mcp.ops.memory.record.start", start)
    assembly = assemble(settings(folder, how), Bridge(no_robot))  # pyright: ignore[reportArgumentType]
    texts: list[str] = []
    with anyio.fail_after(30):
        async with Client(assembly.server, mode=mode, elicitation_callback=ask) as client:
            for _ in range(2):
                result = await client.call_tool("ros2_record_start", {"name": "incident"})
                texts.append(result.content[0].text)  # type: ignore[union-attr]
    assert all(question.startswith("Record all topics") for question in questions)
    assert len(done) == sum(_DONE in text for text in texts)
    return texts, len(questions)


@pytest.mark.parametrize("mode", ["legacy", "auto"])
def test_what_the_user_approves_is_carried_out_once_for_each_answer(
    tmp_path: Path, mode: str, monkeypatch: Any
) -> None:
    answer = ElicitResult(action="accept", content={"approve": True})
    texts, asked = anyio.run(outcomes, tmp_path, mode, "elicitation", answer, monkeypatch)
    assert asked == 2
    assert all(_DONE in text for text in texts)


@pytest.mark.parametrize("mode", ["legacy", "auto"])
@pytest.mark.parametrize(
    "answer",
    [ElicitResult(action="decline"), ElicitResult(action="accept", content={"approve": False})],
    ids=["declined", "not approved"],
)
def test_what_the_user_denies_is_not_carried_out_and_not_asked_again(
    tmp_path: Path, mode: str, answer: ElicitResult, monkeypatch: Any
) -> None:
    texts, asked = anyio.run(outcomes, tmp_path, mode, "elicitation", answer, monkeypatch)
    assert asked == 1
    assert not any(_DONE in text for text in texts)
    assert "denied" in texts[1]


@pytest.mark.parametrize("mode", ["legacy", "auto"])
def test_where_the_policy_does_not_accept_it_nobody_is_asked(tmp_path: Path, mode: str, monkeypatch: Any) -> None:
    answer = ElicitResult(action="accept", content={"approve": True})
    texts, asked = anyio.run(outcomes, tmp_path, mode, "operator", answer, monkeypatch)
    assert asked == 0
    assert all("needs_approval" in text for text in texts)
