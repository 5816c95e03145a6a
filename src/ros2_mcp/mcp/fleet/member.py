"""One robot of a server, with everything that belongs to it alone."""

from __future__ import annotations

from dataclasses import dataclass

from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings


@dataclass(frozen=True, kw_only=True, eq=False)
class Member:
    """One robot: its bridge, guard, jobs and fail-safes (`robot`), its bags (`store`), and its tools (`toolset`).

    `name` is the name that the model uses; empty for the only robot of a server.
    """

    name: str
    settings: Settings
    robot: Robot
    store: BagStore
    toolset: Toolset
