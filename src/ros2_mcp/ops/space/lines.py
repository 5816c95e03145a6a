"""Lines of text for topics, actions and services that are listed by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model.text import named

_MOST_NODES = 3
"""The most nodes named in one line; further nodes are only counted."""


@dataclass(frozen=True, slots=True)
class Named:
    """A topic, action or service with its name, its type (without package), its value or rate, and the nodes that
    subscribe to or serve it; fields that are not known are empty.
    """

    name: str
    type: str = ""
    value: str = ""
    listeners: Sequence[str] = ()

    @property
    def line(self) -> str:
        """The line of text, such as `/mode String «manual»` or `/spin Spin → /behavior_server`."""
        kind = f" {named(self.type)}" if self.type else ""
        return f"{named(self.name)}{kind}{f' {self.value}' if self.value else ''}{to_nodes(self.listeners)}"


def to_nodes(nodes: Sequence[str]) -> str:
    """Return " → " and the nodes that receive the messages or requests; empty if there are none."""
    return f" → {some_nodes(nodes, ' and ')}" if nodes else ""


def some_nodes(nodes: Sequence[str], between: str) -> str:
    """Return the names of the first nodes and the number of the others."""
    more = f" and {len(nodes) - _MOST_NODES} more" if len(nodes) > _MOST_NODES else ""
    return f"{between.join(map(named, nodes[:_MOST_NODES]))}{more}"
