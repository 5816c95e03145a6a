"""The carrier of a robot elsewhere: the system's ssh, docker or another command carries the stream.

The bridge is sent along (`bootstrap.py`), and nothing is installed or written there. ssh is the system's own, with the
user's configuration, agent and known hosts; each carrier has a connection of its own, so that its keepalive and its
death are ours. See docs/decisions/0039-the-users-own-ssh.md.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable, Mapping, Sequence

from ros2_mcp.link.bootstrap import PACKAGE, Arrival, bootstrap, installed
from ros2_mcp.link.carrier import Vitality
from ros2_mcp.link.child import Child
from ros2_mcp.link.installation import Command, search_of
from ros2_mcp.link.refusals import of_ssh
from ros2_mcp.model.address import RobotAddress
from ros2_mcp.model.errors import BadInput, LinkError, Unreachable
from ros2_mcp.model.text import quoted
from ros2_mcp.settings import Settings

# ssh's own limit on connecting, the handshake included. Chosen: a robot on a slow link takes two or three.
CONNECT_S = 10
# From the start until stage 1 says its first word. Ten seconds of it are ssh's; a Python starts in two, even from the
# card of a small machine. Chosen.
REACH_S = 12.0
# A bridge that hears nothing for so long has no server any more: it stops everything and leaves. Chosen: longer than
# any outage in which the same connection lives on (ssh gives up after 4 s), so that it is not in its successor's way.
ORPHAN_S = 15
# Characters of what a command said that started no bridge: its last sentence or two. Chosen.
_MOST_SAID = 300
_KEEPALIVE = ("ServerAliveInterval=1", "ServerAliveCountMax=3")
# What must hold whatever the user's configuration says of this host: no terminal, no questions, a connection of our
# own (a shared one would outlive us, and its keepalive is not ours), and nothing else than our stream on it. `IPQoS`:
# the default without a terminal is what Wi-Fi calls background.
_SSH_OPTIONS = (
    "BatchMode=yes",
    f"ConnectTimeout={CONNECT_S}",
    *_KEEPALIVE,
    "ControlMaster=no",
    "ControlPath=none",
    "ClearAllForwardings=yes",
    "ForwardX11=no",
    "PermitLocalCommand=no",
    "RemoteCommand=none",
    "LogLevel=ERROR",
    "IPQoS=none",
)
_logger = logging.getLogger(__name__)


def start_remote(
    settings: Settings, env: Mapping[str, str] = os.environ, *, under_policy: bool = False
) -> RemoteBridge:
    """Starts a bridge where the settings say that the robot is; arguments and errors as of `start_carrier`."""
    return RemoteBridge(settings, env, ["--orphan-s", str(ORPHAN_S), *(("--under-policy",) if under_policy else ())])


def ssh_words(address: RobotAddress, options: Sequence[str], *, may_ask: bool = False) -> list[str]:
    """The beginning of a command line of ssh, up to the host.

    The user's options come first: ssh takes the first of each. `may_ask`: a person is at a terminal, who accepts a host
    key and unlocks keys.
    """
    ours = [option for option in _SSH_OPTIONS if not (may_ask and option.startswith(("BatchMode", "LogLevel")))]
    words = ["ssh", "-T", *options, *(word for option in ours for word in ("-o", option))]
    words += ["-p", str(address.port)] if address.port else []
    return [*words, "--", f"{address.user}@{address.host}" if address.user else address.host]


def way_to(settings: Settings) -> list[str]:
    """The words of the program that gives a shell where the robot is."""
    address = settings.robot
    if address.kind == "ssh":
        return ssh_words(address, settings.ssh_options)
    if address.kind == "docker":
        return ["docker", "exec", "-i", address.container]
    return list(address.command)


def is_installed(settings: Settings) -> bool:
    """Whether the robot's command starts a bridge that is installed there, by the name of its package.

    Raises:
        BadInput: if it does, and other settings say which ROS is looked for: that is decided by the command.
    """
    words = settings.robot.command
    if not any(PACKAGE in word for word in words):
        return False
    if search_of(settings) != search_of(Settings()):
        raise BadInput(
            f"The command of --robot-command starts {PACKAGE} that is installed there, in the ROS that it chooses.",
            "Say there which: … 'source DIR/setup.bash; ROS_DOMAIN_ID=7 ros2 run ros2_mcp_bridge bridge'; or leave out "
            "--distro, --workspace, --ros-root, --bridge-python, --domain-id, --rmw and --robot-env.",
        )
    return True


class RemoteBridge(Child):
    """A bridge on another machine or in a container. It is a `Carrier`."""

    is_remote = True

    # Over ssh the handshake alone takes some fourteen round trips, then ROS is found and starts, from a slow card
    # perhaps. What cannot be reached at all is told long before (REACH_S).
    start_s = 40.0

    lease_s = 2.0
    """Eight pings. Measured over 100 ms, with 15 % loss or a camera at 5 Mbit/s: at most 1.0 s between two of them."""

    def __init__(self, settings: Settings, env: Mapping[str, str], options: Sequence[str]) -> None:
        """Starts the program that reaches it, without waiting for anything.

        Raises:
            LinkError: if that program is not there.
            BadInput: for settings that a bridge which is installed cannot be told.
        """
        self.address = settings.robot
        self._ssh_options = settings.ssh_options
        way = way_to(settings)
        # Of an address of ssh the container is entered on the far side; that of docker:// is here.
        inner = self.address.container if self.address.kind == "ssh" else ""
        self._is_installed = is_installed(settings)
        if self._is_installed:
            start = installed(way, options)
        else:
            start = bootstrap(way, search_of(settings), container=inner, options=options)
        self._arrival = start.arrival
        self._unreached: LinkError | None = None
        self._received: Callable[[bytes], None] = lambda _: None
        self._patience: asyncio.TimerHandle | None = None
        try:
            super().__init__(Command(start.argv, env), pass_stderr=settings.debug)
        except OSError as error:
            hint = (
                f"Install it: {self.address.place} is reached with it." if isinstance(error, FileNotFoundError) else ""
            )
            raise Unreachable(f"{way[0]} cannot be started: {error.strerror}.", hint, is_lasting=True) from error
        # So that it comes up while the rest of the server is imported, and not only after that.
        self._to_be_sent = self.write_at_once(start.pack())

    @property
    def arrival(self) -> Arrival:
        """What was heard before the stream."""
        return self._arrival

    @property
    def origin(self) -> str:
        """Which ROS was found there and why, once it is known."""
        found = next((report.details for report in self._arrival.reports if report.stage == "found"), None)
        return f"At {self.address.place}: {quoted(found.get('why', ''))}" if found else f"At {self.address.place}."

    def describe(self) -> str:
        """Its address."""
        return self.address.place

    async def open(self, received: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        """Connects the pipes, and sends what is left of the bridge."""
        self._received = received
        await super().open(self._hear, ended)
        self.write(self._to_be_sent)
        self._to_be_sent = b""
        self._patience = asyncio.get_running_loop().call_later(REACH_S, self._lose_patience)

    def _hear(self, piece: bytes) -> None:
        stream = self._arrival.feed(piece)
        if self._patience and (self._arrival.reports or self._arrival.failure):
            self._patience.cancel()
            self._patience = None
        if stream:
            self._received(stream)
        elif self._arrival.failure:
            self.kill()  # a login that goes on for ever would not end by itself

    def _lose_patience(self) -> None:
        """Nobody answers, or somebody else than stage 1."""
        self._patience = None
        heard = self._arrival.heard
        said = f"the login there printed {quoted(heard)} and" if heard else "the login there"
        self._unreached = Unreachable(
            f"{self.address.place} did not start the bridge within {REACH_S:.0f} s: {said} hangs.",
            "A start-up file (.bashrc, .zshenv, …) may wait for input: try it by hand, with a command that ends "
            "at once.",
        )
        self.kill()

    async def failure(self) -> LinkError | None:
        """Why it was not reached, from what the far side and the way in said."""
        if self._unreached:
            return self._unreached
        code = await self.exit_code()
        lines = self.log_tail()
        if not self._arrival.reports and (refused := self._refused_by_ssh(code)):
            return refused
        if self._is_installed and not self._arrival.reports:
            said = quoted(" ".join([self._arrival.heard, *lines]).strip()[-_MOST_SAID:]) or "nothing"
            return Unreachable(
                f"The command of --robot-command started no bridge: it said {said}, and ended with code {code}.",
                f"Try it by hand with --help behind it. {PACKAGE} must be built there (colcon build), its workspace "
                "be sourced in the command, and be of this version.",
            )
        if told := self._arrival.explain(code, lines):
            return Unreachable(f"{self.address.place}: {told.message}", told.hint)
        if self._arrival.reports:
            return None  # the bridge itself, whose last words say more
        heard = " ".join([self._arrival.heard, *lines]).strip()
        said = f"said {quoted(heard)}" if heard else "said nothing"
        return Unreachable(
            f"{self.address.place} was not reached: the login there {said}, and ended with code {code}.",
            "It needs a shell that runs commands: try it by hand, with a command such as: true",
        )

    async def ending(self) -> str:
        """How the way in ended."""
        code = await self.exit_code()
        if refused := self._refused_by_ssh(code):
            return f"is out of reach ({refused.message.rstrip('.')})"
        return "closed its stream" if code in (None, 0) else f"ended with code {code}"

    def _refused_by_ssh(self, code: int | None) -> Unreachable | None:
        return of_ssh(self.address, code, self.log_tail(), self._ssh_options) if self.address.kind == "ssh" else None

    def alive(self) -> Vitality:
        """Unknown: what can be seen here is ssh, and not the bridge."""
        return "unknown"

    async def close(self, grace_s: float) -> None:
        """As of a child; nothing is waited for any more."""
        if self._patience:
            self._patience.cancel()
        await super().close(grace_s)
