"""Robots in URIs: if a server has several, each URI names a robot, as in `ros2://log?level=warn&robot=lab`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from urllib.parse import unquote

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import listed, quoted
from ros2_mcp.ops.watch.watchers import Subject, Watcher
from ros2_mcp.resources.catalogue import Declared, subject_of
from ros2_mcp.robot import Robot

ROBOT = "robot"
_QUERY = re.compile(r"\{\?([\w,]+)\}$")
"""The query of a URI template; the group holds its variables."""
_MOST_NAMED = 15
"""The most robots in one error text."""


class ByRobot:
    """The robots of a server by name, each with its watcher."""

    def __init__(self, robots: Mapping[str, Robot]) -> None:
        self._robots = {name: (robot, Watcher(robot)) for name, robot in robots.items()}
        self.names: Sequence[str] = list(robots) if len(robots) > 1 else ()

    def found(self, uri: str) -> tuple[Robot, Watcher, str, Mapping[str, str]]:
        """Return the robot that a URI names, its watcher, the URI without the robot, and the first fields of the
        content.

        Raises:
            BadInput: if the URI names no known robot. It lists the names.
        """
        if not self.names:
            robot, watcher = next(iter(self._robots.values()))
            return robot, watcher, uri, {}
        path, _, query = uri.partition("?")
        parts = [part for part in query.split("&") if part]
        named = [unquote(part.partition("=")[2]) for part in parts if part.startswith(f"{ROBOT}=")]
        others = "&".join(part for part in parts if not part.startswith(f"{ROBOT}="))
        if len(named) != 1 or named[0] not in self._robots:
            there_are = f"There are: {listed(self.names, _MOST_NAMED)}."
            if len(named) != 1:
                raise BadInput("The URI has to say which robot it is about, once, such as ?robot=NAME.", there_are)
            raise BadInput(f"There is no robot {quoted(named[0])}.", did_you_mean(named[0], self.names, there_are))
        robot, watcher = self._robots[named[0]]
        return robot, watcher, f"{path}?{others}" if others else path, {ROBOT: named[0]}

    def watched(self, uri: str) -> tuple[Watcher, Subject]:
        """Return the watcher and the subject for a subscription to this URI. Raises as `found` and `subject_of`."""
        _, watcher, plain, _ = self.found(uri)
        return watcher, subject_of(plain)

    def listed(self, row: Declared) -> Iterator[tuple[str, str, str]]:
        """Yield URI, name and title of a resource without variables, for each robot."""
        if not self.names:
            yield row.uri, row.name, row.title
        for name in self.names:
            yield f"{row.uri}?{ROBOT}={name}", f"{row.name}-{name}", f"{row.title} ({name})"

    def template(self, uri: str) -> str:
        """Return a URI template, with the robot as a further variable if there are several."""
        if not self.names:
            return uri
        query = _QUERY.search(uri)
        return _QUERY.sub(f"{{?{query[1]},{ROBOT}}}", uri) if query else f"{uri}{{?{ROBOT}}}"
