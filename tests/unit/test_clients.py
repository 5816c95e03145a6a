"""What a model sees of our results in the two kinds of clients that show it something else than text and pictures.

The rules were read off real clients' requests (decision 58); `tests/clients` has the clients themselves.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence

import pytest
from mcp.types import CallToolResult, ContentBlock, ImageContent, TextContent

from ros2_mcp.mcp.binding import answer
from ros2_mcp.mcp.fleet.about_all import RobotStates, StoppedRobots
from ros2_mcp.mcp.server import text_alone
from ros2_mcp.tools import TOOLS
from support.made_results import made

RESULTS = {tool.name: tool.signature().return_annotation for tool in TOOLS}
RESULTS |= {"ros2_robots": RobotStates, "ros2_stop of all": StoppedRobots}

Rule = Callable[[CallToolResult], Sequence[ContentBlock]]


def structure_replaces_all(result: CallToolResult) -> Sequence[ContentBlock]:
    """Codex: where there is structured content, its JSON is all that the model gets."""
    return [structure_of(result)] if result.structured_content is not None else result.content


def structure_replaces_text(result: CallToolResult) -> Sequence[ContentBlock]:
    """Claude Code: where there is structured content, its JSON stands in the place of the texts."""
    if result.structured_content is None:
        return result.content
    return [structure_of(result), *(block for block in result.content if block.type != "text")]


def structure_of(result: CallToolResult) -> TextContent:
    return TextContent(type="text", text=json.dumps(result.structured_content, ensure_ascii=False))


def text_of(blocks: Sequence[ContentBlock]) -> str:
    return "\n".join(block.text for block in blocks if isinstance(block, TextContent))


def pictures_in(blocks: Sequence[ContentBlock]) -> int:
    return sum(isinstance(block, ImageContent) for block in blocks)


@pytest.mark.parametrize("rule", [structure_replaces_all, structure_replaces_text])
@pytest.mark.parametrize("name", RESULTS)
def test_a_model_sees_our_text_and_all_pictures(name: str, rule: Rule) -> None:
    whole = answer(made(RESULTS[name]))
    seen = rule(text_alone(whole))
    meant = text_of(whole.content)
    assert text_of(seen).splitlines()[0] == meant.splitlines()[0]
    assert pictures_in(seen) == pictures_in(whole.content)
    assert len(text_of(seen).encode()) <= 1.1 * len(meant.encode())


@pytest.mark.parametrize("name", RESULTS)
def test_structured_content_begins_with_the_summary(name: str) -> None:
    whole = answer(made(RESULTS[name]))
    first, value = next(iter((whole.structured_content or {}).items()))
    assert first == "summary"
    assert text_of(whole.content).startswith(value)


def test_some_results_have_pictures() -> None:
    assert sum(pictures_in(answer(made(kind)).content) > 0 for kind in RESULTS.values()) >= 8


def test_what_was_not_done_is_an_error_and_what_was_stopped_is_none() -> None:
    """Of each outcome of programs, motions and goals whether a client is told of an error."""
    errors: dict[str, set[str]] = {}
    for name in ("ros2_program_run", "ros2_drive", "ros2_move_until", "ros2_joint_move", "ros2_navigate"):
        schema = next(tool for tool in TOOLS if tool.name == name).signature().return_annotation
        errors[name] = {
            result.outcome for number in range(12) if answer(result := made(schema, number=number)).is_error
        }
    assert errors == {
        "ros2_program_run": {"failed", "limit", "crashed"},
        "ros2_drive": {"guard", "silent", "stuck", "jumped", "missed", "timeout", "refused", "no_subscriber"},
        "ros2_move_until": {"silent", "no_subscriber", "refused"},
        "ros2_joint_move": {"silent", "timeout", "aborted", "rejected", "no_subscriber"},
        "ros2_navigate": {"failed", "rejected", "not begun"},
    }
