"""The carrier of a remote robot: the system's ssh, docker or another command transports the stream.

The bridge is sent along (`bootstrap.py`); nothing is installed or written there. ssh is the system's own, with the
user's configuration, agent and known hosts. Each carrier has its own connection, so that its keepalive and its end are
controlled here. See docs/decisions/0039-the-users-own-ssh.md.
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

# ssh's own limit on connecting, in s, including the handshake: a robot on a slow link takes two or three.
CONNECT_S = 10
# The time until the first line of stage 1, in s: ten for ssh, and two for the start of a Python, even from the card of
# a small machine.
REACH_S = 12.0
# A bridge without any packet for this long, in s, has no server any more: it stops everything and exits. Longer than
# any outage that one connection survives (the server gives up after 4 to 5 s, ssh after 13), so that it does not
# disturb its successor.
ORPHAN_S = 15
# The most characters of a failed command's output in an error: its last sentence or two.
_MOST_SAID = 300
# ssh's own questions whether the robot still answers, which matter until the bridge answers pings (`heartbeat.py`). ssh
# reads the zip in packets of 32 KiB, behind which its questions wait: 4 s each at 64 kbit/s. Less than ORPHAN_S.
_KEEPALIVE = ("ServerAliveInterval=1", "ServerAliveCountMax=12")
# Options that must hold whatever the user's configuration says: no terminal, no questions, a connection of its own (a
# shared one would outlive this server, with another keepalive), and nothing else than the stream on it. `IPQoS`: ssh's
# default without a terminal is the background class of Wi-Fi.
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
    """Start a bridge on the remote robot in the settings; arguments and errors as in `start_carrier`."""
    return RemoteBridge(settings, env, ["--orphan-s", str(ORPHAN_S), *(("--under-policy",) if under_policy else ())])


def ssh_words(address: RobotAddress, options: Sequence[str], *, may_ask: bool = False) -> list[str]:
    """Return the beginning of an ssh command line, up to the host.

    The user's options come first, because ssh uses the first value of each option. `may_ask`: a person at the terminal
    can accept a host key and unlock keys.
    """
    ours = [option for option in _SSH_OPTIONS if not (may_ask and option.startswith(("BatchMode", "LogLevel")))]
    words = ["ssh", "-T", *options, *(word for option in ours for word in ("-o", option))]
    words += ["-p", str(address.port)] if address.port else []
    return [*words, "--", f"{address.user}@{address.host}" if address.user else address.host]


def way_to(settings: Settings) -> list[str]:
    """Return the words of the program that opens a shell where the robot is."""
    address = settings.robot
    if address.kind == "ssh":
        return ssh_words(address, settings.ssh_options)
    if address.kind == "docker":
        return ["docker", "exec", "-i", address.container]
    return list(address.command)


def is_installed(settings: Settings) -> bool:
    """Return whether the robot's command starts a bridge that is installed there: whether it has the package's name.

    Raises:
        BadInput: if it does, and other settings choose a ROS, which is up to the command.
    """
    words = settings.robot.command
    if not any(PACKAGE in word for word in words):
        return False
    if search_of(settings) != search_of(Settings()):
        raise BadInput(
            f"--robot-command starts the {PACKAGE} that is installed there, in the ROS 2 that the command sets up.",
            "Set it up there: … 'source DIR/setup.bash; ROS_DOMAIN_ID=7 ros2 run ros2_mcp_bridge bridge'; or leave out "
            "--distro, --workspace, --ros-root, --bridge-python, --domain-id, --rmw and --robot-env.",
        )
    return True


class RemoteBridge(Child):
    """A bridge on another machine or in a container; implements `Carrier`."""

    is_remote = True

    # Over ssh, the handshake alone takes some fourteen round trips; then ROS is found and started, possibly from a slow
    # card. An unreachable robot is reported much earlier (REACH_S).
    start_s = 40.0

    lease_s = 2.0
    """The link lease, in s: eight pings. Measured over 100 ms, with 15 % loss or a camera at 5 Mbit/s: at most 1.0 s
    between two of them."""

    def __init__(self, settings: Settings, env: Mapping[str, str], options: Sequence[str]) -> None:
        """Start the program that reaches the robot, without waiting for anything.

        Raises:
            LinkError: if that program does not exist.
            BadInput: for settings that an installed bridge cannot get.
        """
        self.address = settings.robot
        self._ssh_options = settings.ssh_options
        way = way_to(settings)
        # With an ssh address the container is entered on the far side; with docker:// it is entered here.
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
        # Sent now, so that the bridge starts while the rest of the server is being imported.
        self._to_be_sent = self.write_at_once(start.pack())

    @property
    def arrival(self) -> Arrival:
        """The reader of the bytes before the stream, with its reports."""
        return self._arrival

    @property
    def origin(self) -> str:
        """The ROS that was found there and why, once it is known."""
        found = next((report.details for report in self._arrival.reports if report.stage == "found"), None)
        return f"At {self.address.place}: {quoted(found.get('why', ''))}" if found else f"At {self.address.place}."

    def describe(self) -> str:
        """Return the robot's address."""
        return self.address.place

    async def open(self, received: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        """Connect the pipes, and send the rest of the bridge."""
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
            self.kill()  # a login that runs for ever does not end on its own

    def _lose_patience(self) -> None:
        """Give up: there was no reply, or none of stage 1."""
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
        """Return why the robot was not reached, from the output of the far side and of the way in."""
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
            return None  # the bridge itself failed; its last lines say more
        heard = " ".join([self._arrival.heard, *lines]).strip()
        said = f"said {quoted(heard)}" if heard else "said nothing"
        return Unreachable(
            f"{self.address.place} was not reached: the login there {said}, and ended with code {code}.",
            "It needs a shell that runs commands: try it by hand, with a command such as: true",
        )

    async def ending(self) -> str:
        """Return how the way in ended."""
        code = await self.exit_code()
        if refused := self._refused_by_ssh(code):
            return f"is out of reach ({refused.message.rstrip('.')})"
        return "closed its stream" if code in (None, 0) else f"ended with code {code}"

    def _refused_by_ssh(self, code: int | None) -> Unreachable | None:
        return of_ssh(self.address, code, self.log_tail(), self._ssh_options) if self.address.kind == "ssh" else None

    def alive(self) -> Vitality:
        """Return `unknown`: only ssh can be observed here, not the bridge."""
        return "unknown"

    async def close(self, grace_s: float) -> None:
        """Close as a child process; cancel the time limit of the start."""
        if self._patience:
            self._patience.cancel()
        await super().close(grace_s)
