"""The servers that act on a robot, as an operator or the page reaches them: by the sockets in its state folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from ros2_mcp.guard.operating import sockets_of
from ros2_mcp.guard.operators import connected
from ros2_mcp.model.errors import BadInput, NotFound, RobotError

_ANSWER_BYTES = 16_000_000
"""Of one answer: a value of a few megabytes, written as JSON."""

Row = Mapping[str, Any]


class Ended(RobotError):
    """The server has ended, or has closed the connection."""

    def __init__(self) -> None:
        super().__init__(
            "The server has ended, and with it what waited for approval.",
            "Run ros2-mcp operate again when there is one; without one, operate reset (with the same --policy) resets "
            "the latch.",
        )


class Server:
    """One server that an operator is connected to; `folder` is the state folder of its robot.

    It is waited for as long as a stop takes, or for `patience_s`.
    """

    def __init__(self, path: Path, patience_s: float | None = None) -> None:
        self.path = path
        self.folder = path.resolve().parent
        self._connection = connected(path)
        if patience_s is not None:
            self._connection.settimeout(patience_s)
        self._lines = self._connection.makefile("rb")

    def do(self, what: str, **arguments: Any) -> Row:
        """One request and its answer.

        Raises:
            RobotError: with what the server answers, or because it is gone.
        """
        self.tell(what, **arguments)
        return self.answer()

    def tell(self, what: str, **arguments: Any) -> None:
        """One request, whose answer is taken later. Raises `RobotError` if the server is gone."""
        try:
            self._connection.sendall(json.dumps({"do": what, **arguments}).encode() + b"\n")
        except OSError as error:
            raise Ended from error

    def answer(self, patience_s: float | None = None) -> Row:
        """The answer to what was told; raises as `do`."""
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
        """Ends the connection."""
        self._lines.close()
        self._connection.close()


def servers_in(folder: Path, patience_s: float | None = None, *, of_one: bool = True) -> list[Server]:
    """Connections to all servers of that robot; sockets that a dead one left are removed.

    Where that folder has none, those of the one robot that has a folder of its own and a link here; or without
    `of_one`, for who stops them, of all such robots.

    Raises:
        NotFound: if there is none.
        BadInput: if links lead to several robots, and one is meant.
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
            f"No server of the robot {folder.name} runs.",
            f"It would have a socket in {folder}. Of a robot that its policy names: ros2-mcp --policy FILE operate, or "
            "--state DIR. Without a server, the same with operate reset resets the latch.",
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
