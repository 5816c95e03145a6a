"""Explanations of ssh's errors: one sentence and a hint for each.

ssh writes its errors in English to stderr, whatever the language of the user, and exits with 255.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model.address import RobotAddress
from ros2_mcp.model.errors import Unreachable
from ros2_mcp.model.text import quoted

_FAILED = 255


@dataclass(frozen=True, slots=True)
class _Refusal:
    """An explanation of one of ssh's messages: `sign` matches ssh's text, `message` explains it; `is_lasting`: another
    attempt would fail as well.
    """

    sign: re.Pattern[str]
    message: str
    hint: str
    is_lasting: bool = False


def _refusal(sign: str, message: str, hint: str, *, is_lasting: bool = False) -> _Refusal:
    return _Refusal(re.compile(sign, re.IGNORECASE), message, hint, is_lasting)


# The first match applies: specific messages precede general ones.
_REFUSALS: Sequence[_Refusal] = (
    _refusal(
        "remote host identification has changed",
        "{host} shows another host key than the known one: it was reinstalled, or another machine impersonates it.",
        "If it was, run: {forget}, then: {doctor}",
        is_lasting=True,
    ),
    _refusal(
        "host key verification failed|host key is known for|no matching host key fingerprint",
        "The host key of {host} is not known here, and this server never accepts a new one by itself.",
        "Run once in a terminal, and compare the key: {doctor}",
        is_lasting=True,
    ),
    _refusal(
        "could not resolve hostname|name or service not known|nodename nor servname",
        "There is no machine called {host}: its name is not known here.",
        "Correct the name, give the IP address, or add it to ~/.ssh/config; is this machine in the robot's network?",
    ),
    _refusal(
        "bad configuration option|unknown option|illegal option|extra arguments|^usage: ssh|can't open user config",
        "ssh does not understand what it was given: {said}.",
        "Correct --ssh-option (ROS2_MCP_SSH_OPTION), or ~/.ssh/config.",
        is_lasting=True,
    ),
    _refusal(
        "refused operation|agent refused",
        "The agent of ssh does not use its key for {host}: {said}.",
        "Unlock it, or touch the security key: run in a terminal: {doctor}",
        is_lasting=True,
    ),
    _refusal(
        "permission denied|too many authentication failures|no more authentication methods",
        "{host} does not let {user} in: {said}.",
        "Give it a key, once, in a terminal: {copy}; a key with a passphrase has to be in ssh-agent (ssh-add).",
        is_lasting=True,
    ),
    _refusal(
        "unable to negotiate|no matching",
        "ssh here and on {host} have no algorithm in common: {said}.",
        "Allow an older one for this host in ~/.ssh/config.",
        is_lasting=True,
    ),
    _refusal(
        "connection refused",
        "{host} is there, but nothing answers at its port {port}.",
        "Start ssh there (apt-get install openssh-server), or correct the port of the address.",
    ),
    _refusal(
        "no route to host|network is unreachable|host is down",
        "{host} cannot be reached from here: {said}.",
        "Is this machine in the robot's network (Wi-Fi, VPN), and is the robot switched on?",
    ),
    _refusal(
        "timed out|timeout, server",
        "{host} does not answer.",
        "Is it switched on, and is this machine in its network (Wi-Fi, VPN)?",
    ),
    _refusal(
        "exec request failed|shell request failed|administratively prohibited",
        "{host} lets {user} in, but runs no commands for this login: {said}.",
        "Its sshd must allow commands to this user (no ForceCommand, a shell).",
        is_lasting=True,
    ),
    _refusal(
        "connection (closed|reset)|closed by remote host|broken pipe|connection to .* closed",
        "{host} ended the connection: {said}.",
        "Its sshd may refuse this machine or user, or be busy: look at its log (journalctl -u ssh).",
    ),
)


def of_ssh(
    address: RobotAddress, exit_code: int | None, lines: Sequence[str], options: Sequence[str] = ()
) -> Unreachable | None:
    """Return the explanation of a failed start of ssh; None if ssh itself did not fail.

    Args:
        address: the address of the robot.
        exit_code: ssh's exit code; None if unknown.
        lines: the last lines of its stderr, oldest first.
        options: the server's additional options for ssh, which commands in a hint repeat.
    """
    if exit_code not in (_FAILED, None):
        return None
    text = "\n".join(lines)
    for refusal in _REFUSALS:
        if refusal.sign.search(text):
            line = next((line for line in reversed(lines) if refusal.sign.search(line)), "")
            words = _words(address, line, options)
            return Unreachable(
                refusal.message.format(**words), refusal.hint.format(**words), is_lasting=refusal.is_lasting
            )
    if exit_code is None:
        return None
    said = next((line for line in reversed(lines) if line.strip()), "")
    told = f"ssh said {quoted(said)}" if said else "ssh said nothing"
    return Unreachable(f"{address.host} was not reached: {told}.", f"Try it by hand: {by_hand(address, options)}")


def _words(address: RobotAddress, line: str, options: Sequence[str]) -> dict[str, str]:
    settings = [option for option in options if option.startswith(("-o", "-F"))]  # ssh-copy-id does not know the others
    known = f"[{address.host}]:{address.port}" if address.port not in (0, 22) else address.host
    return {
        "host": address.host,
        "user": address.user or "this user",
        "port": str(address.port or 22),
        "said": quoted(line.rstrip(". \r")),
        "doctor": by_doctor(address, options),
        "forget": f"ssh-keygen -R '{known}'",
        "copy": _command("ssh-copy-id", address, settings),
    }


def by_doctor(address: RobotAddress, options: Sequence[str] = ()) -> str:
    """Return the command by which a person at a terminal lets ssh ask its questions."""
    return shlex.join(["ros2-mcp", "doctor", "--robot", address.text, *(f"--ssh-option={each}" for each in options)])


def by_hand(address: RobotAddress, options: Sequence[str] = ()) -> str:
    """Return the ssh command for a person to type, with the server's options."""
    return _command("ssh", address, options)


def _command(program: str, address: RobotAddress, options: Sequence[str]) -> str:
    port = ["-p", str(address.port)] if address.port else []
    return shlex.join([program, *options, *port, f"{address.user}@{address.host}" if address.user else address.host])
