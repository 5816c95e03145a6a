"""One line for a thing of the robot that is told by its name: a topic, an action, a service."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model.text import named

_MOST_NODES = 3
"""Named in one line; of more it is told how many."""


@dataclass(frozen=True, slots=True)
class Named:
    """What is told by its name, with its type (no package), how often it comes or what it tells, and the nodes that
    listen there; empty where that is not known.
    """

    name: str
    type: str = ""
    value: str = ""
    listeners: Sequence[str] = ()

    @property
    def line(self) -> str:
        """`/mode String «manual»`, `/spin Spin → /behavior_server`."""
        kind = f" {named(self.type)}" if self.type else ""
        return f"{named(self.name)}{kind}{f' {self.value}' if self.value else ''}{to_nodes(self.listeners)}"


def to_nodes(nodes: Sequence[str]) -> str:
    """That these nodes take what is sent, with a blank before it; empty where there are none."""
    return f" → {some_nodes(nodes, ' and ')}" if nodes else ""


def some_nodes(nodes: Sequence[str], between: str) -> str:
    """The first nodes, and how many more there are."""
    more = f" and {len(nodes) - _MOST_NODES} more" if len(nodes) > _MOST_NODES else ""
    return f"{between.join(map(named, nodes[:_MOST_NODES]))}{more}"
