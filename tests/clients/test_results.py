"""What the model reads in real clients: 21 calls on the simulated robot, and the list of tools."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pytest

from support.clients.calls import CALLS, REFUSED
from support.clients.client import Client, session
from support.clients.script import Request, ShownResult, picture_and_text
from support.clients.table import COLUMNS, Column
from support.processes import peer_command, running

pytestmark = [pytest.mark.full, pytest.mark.timeout(300)]

ENDS_S = 200.0
"""Measured: 22 to 76 s for these calls, beside other work."""
READ_BYTES = 30_000
"""Of the calls that succeed, in all: issue 31."""
OF_CLIENTS = 1.1
"""So many times our text is read at most: clients put a line of their own before it."""


@dataclass(frozen=True)
class Reading:
    """What passed: by the names of the calls what the server sent and what the model was shown; requests, tools."""

    sent: Mapping[str, Mapping[str, Any]]
    shown: Mapping[str, ShownResult]
    requests: list[Request]
    tools: list[dict[str, Any]]
    instructions: str

    def text(self, name: str) -> str:
        return picture_and_text(self.sent[name]["content"])[0]

    def pictures(self, name: str) -> int:
        return sum(part["type"] == "image" for part in self.sent[name]["content"])


@pytest.fixture(scope="module")
def reading(
    client: Client, ros_environment: dict[str, str], robot: subprocess.Popen[str], request: pytest.FixtureRequest
) -> Iterator[Reading]:
    """All calls, one after the other; what was read of them goes into the table."""
    with (
        running(ros_environment, *peer_command("text_peer")),
        session(client, ros_environment, [[call] for call in CALLS.values()], options=client.allow_all) as run,
    ):
        run.ends(ENDS_S)
        shown = [result for turn in run.model.results() for result in turn]
        sent = run.answers("tools/call")
        assert len(sent) == len(shown) == len(CALLS), run.said()
        introduction = (run.answers("initialize") or run.answers("server/discover"))[0]
        found = Reading(
            dict(zip(CALLS, sent, strict=True)),
            dict(zip(CALLS, shown, strict=True)),
            run.model.agent_requests,
            run.answers("tools/list")[0]["tools"],
            introduction["instructions"],
        )
        tools_after_s = run.time_of("tools/list")[1] - run.begun
    request.config.stash.setdefault(COLUMNS, {})[client.name] = Column(
        tools_after_s,
        {name: len(found.text(name).encode()) for name in CALLS},
        {name: result.size_bytes for name, result in found.shown.items()},
        {name: result.pictures for name, result in found.shown.items()},
    )
    yield found


def test_the_first_line_of_every_text_reaches_the_model(reading: Reading) -> None:
    lost = [name for name in CALLS if reading.text(name).splitlines()[0] not in reading.shown[name].text]
    assert lost == []


def test_every_picture_reaches_the_model(reading: Reading) -> None:
    assert reading.pictures("camera") == reading.pictures("scene") == 1
    assert {name: result.pictures for name, result in reading.shown.items()} == {
        name: reading.pictures(name) for name in CALLS
    }


def test_the_model_knows_every_tool_by_name(reading: Reading) -> None:
    names = {tool["name"] for tool in reading.tools}
    assert len(names) > 30
    last = reading.requests[-1]
    told = {name for name in names if last.tool(name) or f"__{name}\\n" in str(last.body)}
    assert names - told == set()


def dotted(text: str) -> str:
    return text.replace("…", "...")


def test_no_description_and_no_result_is_truncated(reading: Reading) -> None:
    sent = {tool["name"]: tool["description"] for tool in reading.tools}
    shown = {name: tool for name in sent if (tool := reading.requests[-1].tool(name))}
    assert shown
    # Claude Code writes three dots for an ellipsis.
    changed = [name for name, tool in shown.items() if tool.description not in (sent[name], dotted(sent[name]))]
    assert changed == []
    signs = ("[truncated]", "tokens truncated")
    assert [name for name, result in reading.shown.items() if any(sign in result.text for sign in signs)] == []


def test_the_instructions_reach_the_model_whole(reading: Reading) -> None:
    lines = reading.instructions.splitlines()
    told = str(reading.requests[-1].body)
    assert [line for line in lines if repr(line)[1:-1] not in told] == []


def test_the_model_reads_hardly_more_than_our_text(reading: Reading) -> None:
    ours = sum(len(reading.text(name).encode()) for name in CALLS)
    assert sum(result.size_bytes for result in reading.shown.values()) <= OF_CLIENTS * ours


def test_nineteen_calls_are_read_in_thirty_kilobytes(reading: Reading) -> None:
    sizes = {name: result.size_bytes for name, result in reading.shown.items() if name not in REFUSED}
    assert len(sizes) == 19
    assert sum(sizes.values()) <= READ_BYTES, sizes


def test_what_fails_reaches_the_model_as_a_failure(reading: Reading) -> None:
    failed = {name for name, result in reading.sent.items() if result.get("isError")}
    assert failed == {*REFUSED, "program that fails"}
    for name in failed:
        assert reading.text(name) in reading.shown[name].text
