"""Connections of an operator, or of the page, to the servers of a robot: by the sockets in its state folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from ros2_mcp.guard.operating import sockets_of
from ros2_mcp.guard.operators import connected
from ros2_mcp.model.errors import BadInput, NotFound, RobotError

_ANSWER_BYTES = 16_000_000
"""The longest answer, in bytes: a value of a few megabytes, written as JSON."""

Row = Mapping[str, Any]


class Ended(RobotError):
    """The server has ended or has closed the connection."""

    def __init__(self) -> None:
        super().__init__(
            "The server has ended, and with it what waited for approval.",
            "Run ros2-mcp operate again when there is one; without one, operate reset (with the same --policy) resets "
            "the latch.",
        )


class Server:
    """An operator's connection to one server; `folder` is the state folder of its robot.

    A request times out after the longest time of a stop, or after `patience_s`.
    """

    def __init__(self, path: Path, patience_s: float | None = None) -> None:
        self.path = path
        self.folder = path.resolve().parent
        self._connection = connected(path)
        if patience_s is not None:
            self._connection.settimeout(patience_s)
        self._lines = self._connection.makefile("rb")

    def do(self, what: str, **arguments: Any) -> Row:
        """Send one request and return its answer.

        Raises:
            RobotError: with the server's error, or if the server has ended.
        """
        self.tell(what, **arguments)
        return self.answer()

    def tell(self, what: str, **arguments: Any) -> None:
        """Send one request; `answer` reads its answer later. Raises `RobotError` if the server has ended."""
        try:
            self._connection.sendall(json.dumps({"do": what, **arguments}).encode() + b"\n")
        except OSError as error:
            raise Ended from error

    def answer(self, patience_s: float | None = None) -> Row:
        """Return the answer to the last request. Raises as `do`."""
        try:
            if patience_s is not None:
                self._connection.settimeout(patience_s)
            line = self._lines.readline(_ANSWER_BYTES)
        except ConnectionError as error:
            raise Ended from error
        except OSError as error:
            raise RobotError(f"The server does not answer: {error}.") from error
        if not line:
            raise Ended
        answer = json.loads(line)
        if not answer["ok"]:
            raise RobotError(answer["error"])
        return cast("Row", answer)

    def close(self) -> None:
        """Close the connection."""
        self._lines.close()
        self._connection.close()


def servers_in(folder: Path, patience_s: float | None = None, *, of_one: bool = True) -> list[Server]:
    """Connect to all servers of a robot, and remove sockets of servers that have ended.

    If the folder also has links to servers of robots with state folders of their own: with `of_one`, the folder's own
    servers are used, or the linked ones if they belong to one robot; without it, for a stop, all of them.

    Raises:
        NotFound: if no server runs.
        BadInput: if the links lead to several robots, and `of_one` is set.
        RobotError: if the sockets cannot be reached.
    """
    found: list[Server] = []
    try:
        for path in sockets_of(folder):
            try:
                found.append(Server(path, patience_s))
            except (ConnectionRefusedError, FileNotFoundError):
                path.unlink(missing_ok=True)
    except OSError as error:
        raise RobotError(
            f"The server cannot be reached: {error.strerror or error}.",
            "Operators are the user of the server, or the members of the group ros2-operators where there is one.",
        ) from error
    if not found:
        raise NotFound(
            f"No server of the robot {folder.name} is running.",
            f"It would have a socket in {folder}. For a robot that is named by its policy: ros2-mcp --policy FILE "
            "operate, or --state DIR. ros2-mcp operate reset also resets the latch without a server.",
        )
    return _of_one_robot(found) if of_one else found


def _of_one_robot(servers: list[Server]) -> list[Server]:
    own = [server for server in servers if not server.path.is_symlink()]
    folders = sorted({str(server.folder) for server in own or servers})
    if len(folders) == 1:
        return own or servers
    for server in servers:
        server.close()
    raise BadInput("Servers of several robots run.", f"Name one: --state {' or --state '.join(folders)}")
