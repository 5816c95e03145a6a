"""One composition for everything that needs a robot with tools: `serve`, `call`, the documentation and the tests."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mcp.server.lowlevel import Server

from ros2_mcp.adapters.data_black_box import DataBlackBoxes
from ros2_mcp.adapters.wisevision_prompts import code_of
from ros2_mcp.leases import Leases
from ros2_mcp.library import robot_for, running, store_for
from ros2_mcp.link.client import Bridge
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.sources.kinds import OWN_KINDS
from ros2_mcp.ops.sources.source import SourceKind
from ros2_mcp.prompts.catalog import Catalog
from ros2_mcp.robot import Robot
from ros2_mcp.server import build_server
from ros2_mcp.settings import Settings
from ros2_mcp.tools import TOOLS
from ros2_mcp.toolset import Toolset

SOURCE_KINDS: Sequence[SourceKind] = (DataBlackBoxes(), *OWN_KINDS)
"""Where samples can be read from, in the order in which they are asked. A vendor's kind is one line here."""


@dataclass(frozen=True, kw_only=True)
class Assembly:
    """Everything of one server, put together and not yet running.

    `robot` is a recording where the settings name a bag, `toolset` the tools that are offered, `store` the bags.
    """

    settings: Settings
    robot: Robot
    store: BagStore
    toolset: Toolset

    @cached_property
    def catalog(self) -> Catalog:
        """The prompts: ours, and those that the settings name."""
        return Catalog(
            self.robot,
            folder=self.settings.prompts,
            load_code=code_of(self.settings),
            missing=self.toolset.missing,
            tools=[tool.name for tool in TOOLS],
        )

    @cached_property
    def leases(self) -> Leases:
        """Of its clients over HTTP."""
        return Leases(self.robot)

    @cached_property
    def server(self) -> Server[Any]:
        """The MCP server."""
        return build_server(self.robot, self.toolset, self.catalog, self.leases, recording=self.store.subject_name)

    def running(self) -> AbstractAsyncContextManager[None]:
        """While it is entered the bridge is there, if there is a robot; at the end all work of this server is ended."""
        return running(self.robot, self.store)


def assemble(settings: Settings, bridge: Bridge | None = None) -> Assembly:
    """Puts everything together. Starts nothing.

    Args:
        settings: what was asked for.
        bridge: the one that is already coming up; without it, one is made, and launched when it is first needed.

    Raises:
        BadInput: for a group of tools that does not exist.
    """
    store = store_for(settings)
    robot = robot_for(settings, store, bridge)
    toolset = Toolset(robot, store, settings.tools, SOURCE_KINDS)
    return Assembly(settings=settings, robot=robot, store=store, toolset=toolset)
