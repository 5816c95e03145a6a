"""The state of a robot that outlives a server: a folder for each robot, with its latch and lock.

The folder is `XDG_STATE_HOME/ros2-mcp/<robot>` (mode 0700), or `<robot>` in the folder that the policy names. It is
created at the first write. See docs/decisions/0029-latch-and-state.md.
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
"""The longest name of a folder: less than half of what file systems allow. A longer name is replaced by a hash."""


class StateUnusable(RobotError):
    """The state folder cannot be used; the message has the reason."""


@dataclass(frozen=True, slots=True)
class StateFolder:
    """The folder with the state of one robot."""

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
        """Return the folder of a robot, without creating it.

        Args:
            name: the robot's name in the policy; without it, the DDS domain and this host name the robot.
            elsewhere: the identity in the address of a remote robot, used instead of this host.
            domain_id: the DDS domain; None is ROS's default, 0.
            state: the parent folder that the policy names, instead of the default.
            env: the environment, for `XDG_STATE_HOME`.
        """
        domain = f"domain-{domain_id}" if domain_id is not None else ("" if elsewhere else "domain-0")
        robot = name or "@".join(filter(None, [domain, elsewhere or socket.gethostname()]))
        return cls((state or state_home(env)) / _as_file_name(robot))

    @property
    def latch_file(self) -> Path:
        """The path of the latch."""
        return self.path / latch.FILE

    def make(self) -> Path:
        """Return the folder, and create it if necessary.

        Raises:
            StateUnusable: if it cannot be created, or another user could write in it.
        """
        try:
            self.path.mkdir(mode=_MODE, parents=True, exist_ok=True)
            found, above = os.lstat(self.path), self.path.parent.stat()
        except OSError as error:
            raise StateUnusable(f"The state folder cannot be made: {error}.") from error
        if not stat.S_ISDIR(found.st_mode):
            raise StateUnusable(f"The state folder {self.path} is a link, or not a folder.")
        if is_of_others(found):
            raise StateUnusable(f"The state folder {self.path} belongs to another user.")
        if others_can_write(found):
            raise StateUnusable(
                f"Users other than its owner can write in the state folder {self.path}.", f"chmod go-w {self.path}"
            )
        # A user who can rename the folder could replace it by one without a latch. (A group may have a single user.)
        is_open = sys.platform != "win32" and above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX
        if is_open or is_of_others(above):
            raise StateUnusable(
                f"Another user can replace the state folder {self.path}.",
                f"{self.path.parent} must be yours or root's.",
            )
        return self.path

    def latch(self) -> RobotLatch:
        """Return the robot's latch."""
        return RobotLatch(self.latch_file)


def state_home(env: Mapping[str, str] = os.environ) -> Path:
    """Return the parent folder of this user's state folders."""
    return Path(env.get("XDG_STATE_HOME") or Path(env.get("HOME") or "~") / ".local/state").expanduser() / "ros2-mcp"


def state_of(settings: Settings, policy: Policy) -> StateFolder:
    """Return the state folder of the robot that the settings and policies name, without creating it."""
    chosen = next((Path(document.state).expanduser() for document in policy.documents if document.state), None)
    elsewhere = settings.robot.identity
    return StateFolder.of(name=policy.robot, elsewhere=elsewhere, domain_id=settings.domain_id, state=chosen)


def _as_file_name(name: str) -> str:
    """Return the name if it is a plain file name; otherwise its plain part with a hash, so that names stay distinct."""
    if re.fullmatch(r"[A-Za-z0-9_@-][A-Za-z0-9_.@-]*", name) and len(name) <= _MAX_NAME:
        return name
    plain = re.sub(r"[^A-Za-z0-9_@-]+", "_", name)[: _MAX_NAME - 20]
    return f"{plain}~{hashlib.sha256(name.encode()).hexdigest()[:12]}"


class RobotLatch(Latch):
    """The latch of a robot, as the server checks it before each command."""

    def check(self, command: Command[Any]) -> None:
        """Raise `Latched` if the latch is set or cannot be read."""
        if (state := self.look()).is_set:
            said = f"{command.act} is refused: {latched(state)} Nothing was sent."
            raise Latched(said, RESET_HINT, by=f"{named(state.by)}: {quoted(state.reason)}")


def latched(state: LatchState) -> str:
    """Return a clause that says since when, by whom and why the latch is set."""
    since = f" since {datetime.fromtimestamp(state.since).astimezone():%Y-%m-%d %H:%M:%S}" if state.since else ""
    return f"the latch of this robot is set{since}, by {named(state.by)}: {quoted(state.reason)}."


class ServerLock:
    """The lock of the one server that acts on a robot, held from its first command until its process ends.

    Without a policy (`is_strict` false) a second server may act as well, with a note; with one it is refused.
    `on_taken` is called when this server takes the lock: another server may have acted until then.
    """

    def __init__(self, folder: StateFolder | None = None, *, is_strict: bool = False) -> None:
        self._folder = folder
        self._is_strict = is_strict
        self._descriptor: int | None = None
        self._mine: tuple[int, int] | None = None
        self.on_taken: Callable[[], None] = lambda: None

    def check(self) -> str:
        """Take the lock, unless this server has it; return "" on success, otherwise a sentence with the problem.

        Raises:
            Refused: instead of returning the sentence, if the lock is strict.
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
        """Return a sentence if another server holds the lock, otherwise "". Does not take the lock."""
        if self._folder is None or self._is_held():
            return ""
        try:
            descriptor = os.open(self._folder.path / _LOCK, os.O_RDWR | PLAIN)
        except OSError:
            return ""  # no server has acted yet
        try:
            is_free = take_lock(descriptor)
        except OSError:
            is_free = False
        try:
            return "" if is_free else f"Another server acts on this robot, too: {_holder(descriptor)}."
        finally:
            os.close(descriptor)

    def close(self) -> None:
        """Release the lock. Safe to call twice; the kernel releases it when this process dies."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = self._mine = None

    def _is_held(self) -> bool:
        """Return whether this server holds the lock, and its file is still the file that other servers would lock."""
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
    """Return a description of the lock's holder, from the lock file."""
    try:
        return f"process {int(json.loads(read_at(descriptor, 1000, 0))['pid'])}"
    except (OSError, ValueError, KeyError, TypeError):
        return "which one is not known"
