"""What the scripted model does, and what clients show to it, in words that hold for every model's interface."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol


@dataclass(frozen=True)
class Call:
    """A call that the model makes: of one of the server's tools, or of the client's `own`."""

    tool: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    own: bool = False


@dataclass(frozen=True)
class NamedCall:
    """A call under the name that the client gave the tool."""

    call_id: str
    name: str
    namespace: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True)
class ShownTool:
    """A tool as the client describes it to the model."""

    name: str
    namespace: str
    description: str
    definition: Mapping[str, Any]

    def is_for(self, tool: str) -> bool:
        """Whether this is the server's tool of that name; clients put the server's name before it."""
        return self.name == tool or self.name.endswith(f"_{tool}")

    @property
    def size_bytes(self) -> int:
        return len(json.dumps(self.definition, ensure_ascii=False).encode())


@dataclass(frozen=True)
class ShownResult:
    """The result of a call as the client shows it to the model."""

    text: str
    pictures: int
    is_error: bool

    @property
    def size_bytes(self) -> int:
        return len(self.text.encode())


class Interface(Protocol):
    """How one kind of model is asked and answers."""

    def tools(self, body: Mapping[str, Any]) -> list[ShownTool]:
        """The tools that a request offers."""
        ...

    def results(self, body: Mapping[str, Any]) -> dict[str, ShownResult]:
        """The results in the conversation so far, by the id of their call."""
        ...

    def events(self, body: Mapping[str, Any], text: str, calls: Sequence[NamedCall]) -> list[dict[str, Any]]:
        """The events of a streamed answer: a text, and calls."""
        ...


@dataclass(frozen=True)
class Request:
    """One request to the model."""

    at: float
    """Monotonic, in s."""
    body: Mapping[str, Any]
    tools: Sequence[ShownTool]
    results: Mapping[str, ShownResult]

    def tool(self, name: str) -> ShownTool | None:
        """The server's tool of that name, if the request offers it."""
        return next((tool for tool in self.tools if tool.is_for(name)), None)


def call_id(turn: int, number: int = 0) -> str:
    """The id of a call of the script: turns are counted in the conversation by it, whatever else the client asks."""
    return f"turn_{turn}_{number}"


def turns_done(results: Mapping[str, ShownResult]) -> int:
    """How many turns of the script have their results in the conversation."""
    return len({name.split("_")[1] for name in results if name.startswith("turn_")})


def picture_and_text(content: Any) -> tuple[str, int]:
    """The text and the number of pictures in content of any depth."""
    if isinstance(content, str):
        return content, 0
    if isinstance(content, Mapping):
        if content.get("type") in ("image", "input_image"):
            return "", 1
        if content.get("type") == "tool_reference":  # what a search for tools finds
            return content["tool_name"], 0
        return picture_and_text(content.get("text", content.get("content", "")))
    parts = [picture_and_text(part) for part in content or []]
    return "\n".join(text for text, _ in parts if text), sum(pictures for _, pictures in parts)
