"""The definition of a prompt: a name, arguments, and a function that makes messages from them."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from ros2_mcp.model.arguments import Argument, values_of

Role = Literal["user", "assistant"]


@dataclass(frozen=True, slots=True)
class Message:
    """One message of a conversation, as text."""

    text: str
    role: Role = "user"


Write = Callable[[Mapping[str, Any]], Awaitable[Sequence[Message]]]
"""Makes the messages from the checked values of all arguments."""


@dataclass(frozen=True, slots=True)
class Prompt:
    """One prompt; `write` makes its messages."""

    name: str
    title: str
    description: str
    arguments: Sequence[Argument]
    write: Write

    async def messages(self, given: Mapping[str, str]) -> Sequence[Message]:
        """Return the messages for a client's arguments.

        Raises:
            BadInput: naming the argument, its value and what is allowed.
        """
        return await self.write(values_of(self.arguments, given))

    def argument(self, name: str) -> Argument | None:
        """Return the argument of that name; None if there is none."""
        return next((argument for argument in self.arguments if argument.name == name), None)


def step(number: int, tool: str, **arguments: Any) -> str:
    """Return one step of a prompt: a call of a tool with exact arguments. Arguments that are None or empty
    are omitted.
    """
    given = {name: value for name, value in arguments.items() if value not in (None, "", [], ())}
    return f"{number}. Call {tool} with {json.dumps(given, ensure_ascii=False)}"
