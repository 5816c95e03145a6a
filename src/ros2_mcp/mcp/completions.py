"""Completions of arguments: names of the live graph and fixed choices; names that start with the typed text first."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mcp.types import CompleteRequestParams, CompleteResult, Completion, PromptReference

from ros2_mcp.model.text import visible
from ros2_mcp.ops.graph.known_names import live_names, topic_types
from ros2_mcp.robot import Robot

# The protocol allows no more in one answer.
MAX_VALUES = 100
_ONE_OF_MANY = {"topics": "topic", "services": "service", "nodes": "node"}


@dataclass(frozen=True, slots=True)
class CompletionRequest:
    """The completion of an argument: names of a kind (`topic`, `topics`, `message_type`, …), or its choices.

    `type_of` names another argument that holds a topic: the type of that topic is offered first.
    """

    kind: str
    choices: Sequence[str] = ()
    type_of: str = ""


Find = Callable[[str, str], Awaitable[CompletionRequest | None]]
"""Finds how to complete an argument of a prompt (name of the prompt, name of the argument) or of a resource template
(URI, name of the argument).
"""


class Completions:
    """Answers `completion/complete`. `of_prompt` and `of_template` return how to complete an argument.

    With several `robots`, by name, names are taken from the robot that the argument `robot` names.
    """

    def __init__(self, robots: Mapping[str, Robot], *, of_prompt: Find, of_template: Find) -> None:
        self._robots = robots
        self._of_prompt = of_prompt
        self._of_template = of_template

    async def complete(self, _: Any, params: CompleteRequestParams) -> CompleteResult:
        """Return the completions of one argument; none for an unknown argument, prompt or template.

        The answer is quick or empty: it does not wait for a robot that does not answer.
        """
        ref, argument = params.ref, params.argument
        if isinstance(ref, PromptReference):
            request = await self._of_prompt(ref.name, argument.name)
        else:
            request = await self._of_template(ref.uri, argument.name)
        others = (params.context and params.context.arguments) or {}
        values = await self._values(request, argument.value, others) if request else []
        return CompleteResult(
            completion=Completion(
                values=[visible(value) for value in values[:MAX_VALUES]],
                total=len(values) if request else None,
                has_more=len(values) > MAX_VALUES if request else None,
            )
        )

    async def _values(self, request: CompletionRequest, typed: str, others: Mapping[str, str]) -> list[str]:
        """Return the completions of the typed text; of a list, the completions of its last element. `others` are the
        other arguments.
        """
        if request.choices or request.kind == "boolean":
            return ranked(request.choices or ("true", "false"), typed)
        robot = self._robots.get(others.get("robot", "") if len(self._robots) > 1 else next(iter(self._robots)))
        if robot is None:
            return []
        if request.kind in _ONE_OF_MANY:
            before, separator, last = typed.rpartition(",")
            chosen = {name.strip() for name in before.split(",")}
            names = [name for name in await live_names(robot, _ONE_OF_MANY[request.kind]) if name not in chosen]
            lead = f"{before}{separator} " if separator else ""
            return [lead + name for name in ranked(names, last.strip())]
        topic = others.get(request.type_of)
        first = await topic_types(robot, topic) if topic else []
        return ranked(dict.fromkeys([*first, *await live_names(robot, request.kind)]), typed)


def ranked(names: Iterable[str], typed: str) -> list[str]:
    """Return the names that contain the typed text, ignoring case. Those that start with it, with or without a leading
    slash, are first.
    """
    low = typed.lower()
    having = [name for name in names if low in name.lower()]
    return sorted(having, key=lambda name: not name.lower().startswith((low, f"/{low}")))
