"""Completions of arguments: live names of the graph and choices, what starts with the typed text first."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mcp.types import CompleteRequestParams, CompleteResult, Completion, PromptReference

from ros2_mcp.ops.graph.known_names import live_names, topic_types
from ros2_mcp.robot import Robot

MOST = 100
"""The protocol allows no more in one answer."""
_ONE_OF_MANY = {"topics": "topic", "services": "service", "nodes": "node"}


@dataclass(frozen=True, slots=True)
class Wanted:
    """What an argument takes: a kind of name (`topic`, `topics`, `message_type`, …), or one of the choices.

    `type_of` names another argument: a topic whose type is meant, and offered first.
    """

    kind: str
    choices: Sequence[str] = ()
    type_of: str = ""


Find = Callable[[str, str], Awaitable[Wanted | None]]
"""What the argument of a prompt (its name, the argument's name) or of a resource template (its URI, …) takes."""


class Completions:
    """Answers `completion/complete`: `of_prompt` and `of_template` say what an argument takes."""

    def __init__(self, robot: Robot, *, of_prompt: Find, of_template: Find) -> None:
        self._robot = robot
        self._of_prompt = of_prompt
        self._of_template = of_template

    async def complete(self, _: Any, params: CompleteRequestParams) -> CompleteResult:
        """The completions of one argument; none for an argument, a prompt or a template that there is not."""
        ref, argument = params.ref, params.argument
        if isinstance(ref, PromptReference):
            wanted = await self._of_prompt(ref.name, argument.name)
        else:
            wanted = await self._of_template(ref.uri, argument.name)
        if wanted is None:
            return CompleteResult(completion=Completion(values=[]))
        others = (params.context and params.context.arguments) or {}
        return CompleteResult(completion=await completion(self._robot, wanted, argument.value, others))


async def completion(robot: Robot, wanted: Wanted, typed: str, given: Mapping[str, str]) -> Completion:
    """What the typed text may become; quick, or nothing: a robot that does not answer is not waited for.

    Args:
        robot: the robot.
        wanted: what the argument takes.
        typed: what the user has typed; the last of several where a list is taken.
        given: the other arguments so far.
    """
    if wanted.choices:
        return _bounded(ranked(wanted.choices, typed))
    if wanted.kind == "boolean":
        return _bounded(ranked(("true", "false"), typed))
    if wanted.kind in _ONE_OF_MANY:
        before, separator, last = typed.rpartition(",")
        chosen = {name.strip() for name in before.split(",")}
        names = [name for name in await live_names(robot, _ONE_OF_MANY[wanted.kind]) if name not in chosen]
        lead = f"{before}{separator} " if separator else ""
        return _bounded([lead + name for name in ranked(names, last.strip())])
    first = await topic_types(robot, given[wanted.type_of]) if given.get(wanted.type_of) else []
    return _bounded(ranked(dict.fromkeys([*first, *await live_names(robot, wanted.kind)]), typed))


def ranked(names: Iterable[str], typed: str) -> list[str]:
    """The names that contain the typed text: first those that start with it (a leading slash may be left out)."""
    low = typed.lower()
    having = [name for name in names if low in name.lower()]
    return sorted(having, key=lambda name: not name.lower().startswith((low, f"/{low}")))


def _bounded(values: Sequence[str]) -> Completion:
    return Completion(values=list(values[:MOST]), total=len(values), has_more=len(values) > MOST)
