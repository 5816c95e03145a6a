"""What a prompt is: a name, arguments, and the messages that they make."""

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
"""Makes the messages out of a checked value for every argument."""


@dataclass(frozen=True, slots=True)
class Prompt:
    """One prompt."""

    name: str
    title: str
    description: str
    arguments: Sequence[Argument]
    write: Write

    async def messages(self, given: Mapping[str, str]) -> Sequence[Message]:
        """The messages for the arguments of a client.

        Raises:
            BadInput: naming the argument, what was given and what is allowed.
        """
        return await self.write(values_of(self.arguments, given))

    def argument(self, name: str) -> Argument | None:
        """The argument of that name."""
        return next((argument for argument in self.arguments if argument.name == name), None)


def step(number: int, tool: str, **arguments: Any) -> str:
    """One step of a prompt: a call of a tool with exact arguments; those that are None or empty are left out."""
    given = {name: value for name, value in arguments.items() if value not in (None, "", [], ())}
    return f"{number}. Call {tool} with {json.dumps(given, ensure_ascii=False)}"
