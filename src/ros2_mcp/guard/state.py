"""What has to be known of a robot beyond the life of one server: a folder for each robot, with its latch and its lock.

The folder is `XDG_STATE_HOME/ros2-mcp/<robot>` (0700), or what the policy names. It is made when something is first
written. See docs/decisions/0029-latch-and-state.md.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import socket
import stat
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from ros2_mcp.guard.policy import Policy
from ros2_mcp.model.commands import Command
from ros2_mcp.model.errors import Latched, Refused, RobotError
from ros2_mcp.model.text import named, quoted
from ros2_mcp.settings import Settings
from ros2_mcp_common import latch
from ros2_mcp_common.files import PLAIN, is_of_others, others_can_write, read_at, take_lock, write_at
from ros2_mcp_common.latch import Latch, LatchState

RESET_HINT = "Only an operator can reset it, with ros2-mcp operate; reading and stopping still work."
_LOCK = "server.lock"
_MODE = 0o700
_MAX_NAME = 100
"""Of a folder's name: less than half of what file systems allow. What is longer is named by a hash."""


class StateUnusable(RobotError):
    """The state folder cannot be used; the message says why."""


@dataclass(frozen=True, slots=True)
class StateFolder:
    """The folder in which the state of one robot is kept."""

    path: Path

    @classmethod
    def of(
        cls,
        *,
        name: str = "",
        elsewhere: str = "",
        domain_id: int | None = None,
        state: Path | None = None,
        env: Mapping[str, str] = os.environ,
    ) -> StateFolder:
        """The folder of a robot; nothing is made.

        Args:
            name: the robot's, of the policy; without it a robot is its DDS domain and this host.
            elsewhere: or, where it is not reached by the ROS of this machine, what its address says of it.
            domain_id: ROS's own, 0, where it is None.
            state: the folder that the policy names for all this instead.
            env: where `XDG_STATE_HOME` is looked up.
        """
        domain = f"domain-{domain_id}" if domain_id is not None else ("" if elsewhere else "domain-0")
        robot = name or "@".join(filter(None, [domain, elsewhere or socket.gethostname()]))
        return cls((state or state_home(env)) / _as_file_name(robot))

    @property
    def latch_file(self) -> Path:
        """Where the latch is."""
        return self.path / latch.FILE

    def make(self) -> Path:
        """The folder, made if it is not there.

        Raises:
            StateUnusable: if it cannot be made, or somebody else could write in it.
        """
        try:
            self.path.mkdir(mode=_MODE, parents=True, exist_ok=True)
            found, above = os.lstat(self.path), self.path.parent.stat()
        except OSError as error:
            raise StateUnusable(f"The state folder cannot be made: {error}.") from error
        if not stat.S_ISDIR(found.st_mode):
            raise StateUnusable(f"The state folder {self.path} is no folder, or a link to one.")
        if is_of_others(found):
            raise StateUnusable(f"The state folder {self.path} belongs to another user.")
        if others_can_write(found):
            raise StateUnusable(
                f"Others than its owner can write in the state folder {self.path}.", f"chmod go-w {self.path}"
            )
        # Who can rename it puts another one in its place, in which no latch is set. (A group may be that of one user.)
        is_open = sys.platform != "win32" and above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX
        if is_open or is_of_others(above):
            raise StateUnusable(
                f"Another user can exchange the state folder {self.path}.",
                f"{self.path.parent} must be yours or root's.",
            )
        return self.path

    def latch(self) -> RobotLatch:
        """The robot's latch."""
        return RobotLatch(self.latch_file)


def state_home(env: Mapping[str, str] = os.environ) -> Path:
    """Where servers of this user keep what must survive them."""
    return Path(env.get("XDG_STATE_HOME") or Path(env.get("HOME") or "~") / ".local/state").expanduser() / "ros2-mcp"


def state_of(settings: Settings, policy: Policy) -> StateFolder:
    """The folder of the robot that the settings and the policies name; nothing is made."""
    chosen = next((Path(document.state).expanduser() for document in policy.documents if document.state), None)
    elsewhere = settings.robot.identity
    return StateFolder.of(name=policy.robot, elsewhere=elsewhere, domain_id=settings.domain_id, state=chosen)


def _as_file_name(name: str) -> str:
    """The name where it is a plain file name; else what is left of it, with a hash so that two stay two."""
    if re.fullmatch(r"[A-Za-z0-9_@-][A-Za-z0-9_.@-]*", name) and len(name) <= _MAX_NAME:
        return name
    plain = re.sub(r"[^A-Za-z0-9_@-]+", "_", name)[: _MAX_NAME - 20]
    return f"{plain}~{hashlib.sha256(name.encode()).hexdigest()[:12]}"


class RobotLatch(Latch):
    """The latch of a robot as the server asks it, before each command."""

    def check(self, command: Command[Any]) -> None:
        """Raises `Latched` while it is set, or cannot be read."""
        if (state := self.look()).is_set:
            said = f"{command.act} is refused: {latched(state)} Nothing was sent."
            raise Latched(said, RESET_HINT, by=f"{named(state.by)}: {quoted(state.reason)}")


def latched(state: LatchState) -> str:
    """The sentence that says since when and why the latch is set."""
    since = f" since {datetime.fromtimestamp(state.since).astimezone():%Y-%m-%d %H:%M:%S}" if state.since else ""
    return f"the latch of this robot is set{since}, by {named(state.by)}: {quoted(state.reason)}."


class ServerLock:
    """Held by the one server that acts on a robot, from its first command to its end, however it ends.

    Without a policy a second server acts too, and says so (`is_strict` false); with one it is refused. `on_taken` is
    called when this server gets it: another one may have acted until then.
    """

    def __init__(self, folder: StateFolder | None = None, *, is_strict: bool = False) -> None:
        self._folder = folder
        self._is_strict = is_strict
        self._descriptor: int | None = None
        self._mine: tuple[int, int] | None = None
        self.on_taken: Callable[[], None] = lambda: None

    def check(self) -> str:
        """Takes the lock, unless this server has it; returns a sentence if it cannot be had, "" otherwise.

        Raises:
            Refused: instead, where only one server may act.
        """
        if self._folder is None or self._is_held():
            return ""
        try:
            problem = self._take()
        except (OSError, StateUnusable) as error:
            problem = f"Whether another server acts on this robot is not known: {str(error).rstrip('.')}."
        if problem and self._is_strict:
            raise Refused(
                f"{problem} Nothing was sent.", "Under a policy only one server may act on a robot: end the other one."
            )
        return problem

    def other(self) -> str:
        """The sentence that another server has the lock, "" where none has it; takes nothing."""
        if self._folder is None or self._is_held():
            return ""
        try:
            descriptor = os.open(self._folder.path / _LOCK, os.O_RDWR | PLAIN)
        except OSError:
            return ""  # nobody has acted yet
        try:
            is_free = take_lock(descriptor)
        except OSError:
            is_free = False
        try:
            return "" if is_free else f"Another server acts on this robot, too: {_holder(descriptor)}."
        finally:
            os.close(descriptor)

    def close(self) -> None:
        """Gives it up; safe to call twice. The kernel does it when this process dies."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = self._mine = None

    def _is_held(self) -> bool:
        """Whether this server has it, and the file is still the one that others would lock."""
        if self._descriptor is None or self._folder is None:
            return False
        try:
            found = (self._folder.path / _LOCK).stat()
        except OSError:
            found = None
        if found and (found.st_dev, found.st_ino) == self._mine:
            return True
        self.close()
        return False

    def _take(self) -> str:
        assert self._folder
        path = self._folder.make() / _LOCK
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | PLAIN, 0o600)
        try:
            if not take_lock(descriptor):
                holder = _holder(descriptor)
                os.close(descriptor)
                return f"Another server acts on this robot, too: {holder}."
        except OSError:
            os.close(descriptor)
            raise
        found = os.fstat(descriptor)
        self._descriptor, self._mine = descriptor, (found.st_dev, found.st_ino)
        os.ftruncate(descriptor, 0)
        write_at(descriptor, json.dumps({"pid": os.getpid(), "since": time.time()}).encode(), 0)
        self.on_taken()
        return ""


def _holder(descriptor: int) -> str:
    """Who has the lock, as it wrote."""
    try:
        return f"process {int(json.loads(read_at(descriptor, 1000, 0))['pid'])}"
    except (OSError, ValueError, KeyError, TypeError):
        return "which one is not known"
