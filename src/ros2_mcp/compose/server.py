"""The one composition of robots with tools: for `serve`, `call`, the documentation and the tests."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mcp.server.lowlevel import Server

from ros2_mcp.adapters.data_black_box import DataBlackBoxes
from ros2_mcp.adapters.wisevision_prompts import code_of
from ros2_mcp.compose.entries import Entry, entries_of
from ros2_mcp.compose.robot import robot_for, store_for
from ros2_mcp.guard.entrance import warnings_of
from ros2_mcp.guard.state import state_of
from ros2_mcp.link.client import Bridge
from ros2_mcp.mcp.fleet import Fleet, Member
from ros2_mcp.mcp.leases import Leases
from ros2_mcp.mcp.scopes import Scopes
from ros2_mcp.mcp.server import build_server
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.sources.kinds import OWN_KINDS, Sources
from ros2_mcp.ops.sources.source import SourceKind
from ros2_mcp.prompts.catalog import Catalog
from ros2_mcp.prompts.several import CatalogOfSeveral
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from ros2_mcp.tools import TOOLS
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.mesh_files import prefixes_of
from ros2_mcp.view.viewing import Viewing

SOURCE_KINDS: Sequence[SourceKind] = (DataBlackBoxes(), *OWN_KINDS)
"""The kinds of sources of samples, in the order in which they are tried. A vendor's kind is one line here."""


@dataclass(frozen=True, kw_only=True)
class Assembly:
    """All parts of one server, assembled, but not running yet.

    `fleet` has its robots. `robot`, `toolset` and `store` are those of the only or first robot, which is a recording if
    the settings name a bag.
    """

    settings: Settings
    fleet: Fleet

    @property
    def robot(self) -> Robot:
        """The first robot."""
        return self.fleet.first.robot

    @property
    def store(self) -> BagStore:
        """The bags of the first robot."""
        return self.fleet.first.store

    @property
    def toolset(self) -> Toolset:
        """The tools of the first robot."""
        return self.fleet.first.toolset

    @cached_property
    def catalog(self) -> Catalog:
        """The prompts: the base prompts, and the prompts that the settings name."""
        catalog = Catalog(
            self.robot,
            folder=self.settings.prompts,
            programs=self.settings.programs,
            load_code=code_of(self.settings),
            missing=self.toolset.missing,
            why_missing=self.toolset.why_missing,
            tools=[tool.name for tool in TOOLS],
        )
        if not self.fleet.has_several:
            return catalog
        return CatalogOfSeveral(catalog, {name: _own_prompts(member) for name, member in self.fleet.members.items()})

    @cached_property
    def leases(self) -> Leases:
        """The leases of the server's clients over HTTP."""
        return Leases(*(member.robot for member in self.fleet.members.values()))

    @cached_property
    def scopes(self) -> Scopes:
        """The check of the tokens of the server's HTTP clients."""
        return Scopes(self.toolset)

    @cached_property
    def server(self) -> Server[Any]:
        """The MCP server."""
        return build_server(
            self.fleet,
            self.catalog,
            self.leases,
            self.scopes,
            recording=self.store.subject_name,
            structured=self.settings.structured,
        )

    def running(self) -> AbstractAsyncContextManager[None]:
        """Return a context in which the bridge runs, unless the robot is a recording; on exit, all work of this server
        is ended.
        """
        return self.fleet.running()


def assemble(settings: Settings, bridge: Bridge | None = None) -> Assembly:
    """Assemble a server. Starts nothing.

    Args:
        settings: the settings of the server.
        bridge: the bridge of the only robot, if it is already starting; otherwise one is made, and launched when it is
            first needed.

    Raises:
        BadInput: for an unknown group of tools, and for errors in the robots that the settings name.
    """
    entries = entries_of(settings)
    return Assembly(settings=settings, fleet=Fleet([_member(entry, bridge) for entry in entries]))


def _member(entry: Entry, bridge: Bridge | None) -> Member:
    settings = entry.settings
    store = store_for(settings)
    robot = robot_for(settings, store, bridge)
    folder = state_of(settings, robot.policy)
    viewing = Viewing(Sources(robot, store, SOURCE_KINDS), entry.name, Acting(folder), prefixes_of(settings))
    toolset = Toolset(robot, store, settings.tools, SOURCE_KINDS, warnings_of(settings), viewing)
    return Member(name=entry.name, settings=settings, robot=robot, store=store, toolset=toolset)


def _own_prompts(member: Member) -> Catalog:
    """Return the prompts that depend on the robot. The user's own prompts are the same for all robots, and not
    included.
    """
    return Catalog(member.robot, missing=member.toolset.missing, why_missing=member.toolset.why_missing)
