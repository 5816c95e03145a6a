"""The address of a robot, as a user writes it: `ssh://me@robot`, `docker://NAME`, `local`, or `NAME=` before an
address.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal
from urllib.parse import parse_qsl, unquote

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.text import quoted

AddressKind = Literal["local", "ssh", "docker", "command"]

# DDS computes its UDP ports from the domain id (7400 + 250 per domain): from 233 on they would exceed 65535.
MAX_DOMAIN_ID = 232
_MAX_PORT = 65535
_FORMS = "Write ssh://user@host, ssh://user@host:22?container=NAME, docker://NAME or local."
_NAMED = re.compile(r"(?P<name>[A-Za-z0-9][\w.-]*)=(?P<address>.*)", re.ASCII | re.DOTALL)
_PARTS = re.compile(r"(?P<scheme>[a-z][a-z0-9+.-]*)://(?P<rest>[^?#]*)(?:\?(?P<query>[^#]*))?", re.IGNORECASE)
_LOCAL = re.compile(r"local(?:\?(?P<query>.*))?")
_PLACE = re.compile(r"(?:(?P<user>.*)@)?(?P<host>\[[^\]]*\]|[^:@/]*)(?::(?P<port>\d*))?/?")
# Both become words of a command line. None begins with a dash, which ssh and docker would take for an option; and none
# contains a shell metacharacter: ssh puts user and host into the commands of the user's configuration.
_HOST = re.compile(r"[A-Za-z0-9_:][A-Za-z0-9_.:%-]*", re.ASCII)
_USER = re.compile(r"[A-Za-z0-9_.+][A-Za-z0-9_.+@-]*", re.ASCII)
_CONTAINER = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*", re.ASCII)
# Parameters after the question mark, for each kind.
_KEYS: Mapping[str, Sequence[str]] = {
    "ssh": ("container", "domain_id"),
    "docker": ("domain_id",),
    "local": ("domain_id",),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotAddress:
    """One robot and how to reach it.

    `name` is the user's name for the robot, `text` the address as written, without the name. `user`, `host` and `port`
    are for ssh, empty and 0 if ssh's own configuration decides. `container` is one on that host, or for `docker` on
    this machine. `command` is the beginning of a command line that starts a shell there. `domain_id` is None if the
    address does not have it.
    """

    kind: AddressKind
    text: str
    name: str = ""
    user: str = ""
    host: str = ""
    port: int = 0
    container: str = ""
    command: tuple[str, ...] = ()
    domain_id: int | None = None

    @property
    def is_remote(self) -> bool:
        """Whether the bridge runs where this server can see neither its processes nor its files."""
        return self.kind != "local"

    @property
    def place(self) -> str:
        """The name of the robot's location in texts: the address, of whose parameters only the container is kept."""
        if self.kind == "command":
            return self.text
        container = f"?container={self.container}" if self.kind == "ssh" and self.container else ""
        return self.text.partition("?")[0].rstrip("/") + container

    @property
    def identity(self) -> str:
        """The same for every address of this robot, whatever the login and name; empty for `local`.

        The DDS domain is not part of it.
        """
        if self.kind == "local":
            return ""
        if self.kind == "ssh":
            port = f":{self.port}" if self.port not in (0, 22) else ""  # most configurations mean 22 without a port
            container = f"/{self.container}" if self.container else ""
            return f"ssh-{self.host.lower()}{port}{container}"
        return f"{self.kind}-{self.container or shlex.join(self.command)}"

    @property
    def written(self) -> str:
        """The address as a user would write it, with the name."""
        return f"{self.name}={self.text}" if self.name else self.text


LOCAL = RobotAddress(kind="local", text="local")


def of_command(command: Sequence[str], name: str = "") -> RobotAddress:
    """Return the address of a robot behind a command that provides the stdin and stdout of a shell there.

    An example is `kubectl exec -i pod --`.
    """
    return RobotAddress(kind="command", text=shlex.join(command), command=tuple(command), name=name)


def parse_address(text: str) -> RobotAddress:
    """Parse `NAME=ADDRESS` or `ADDRESS`.

    Raises:
        BadInput: naming what is wrong, and what would be right.
    """
    named = _NAMED.fullmatch(text)
    name, address = (named["name"], named["address"]) if named else ("", text)
    if local := _LOCAL.fullmatch(address):
        found = RobotAddress(kind="local", text=address)
        return replace(found, name=name, **_options("local", local["query"], address))
    parts = _PARTS.fullmatch(address)
    if not parts:
        near = f"Did you mean ssh://{address}?" if _is_login(address) else _FORMS
        raise BadInput(f"{quoted(address)} is not the address of a robot.", near)
    scheme, rest = parts["scheme"].lower(), parts["rest"]
    if scheme == "ssh":
        found = _ssh(address, rest)
    elif scheme == "docker":
        container = _checked("container", unquote(rest.rstrip("/")), _CONTAINER, address)
        found = RobotAddress(kind="docker", text=address, container=container)
    else:
        raise BadInput(f"{quoted(address)} begins with {scheme}://, which is not supported.", _FORMS)
    return replace(found, name=name, **_options(scheme, parts["query"], address))


def _ssh(address: str, rest: str) -> RobotAddress:
    place = _PLACE.fullmatch(rest)
    if not place:
        raise BadInput(f"{quoted(address)} is not an ssh address.", _FORMS)
    user = unquote(place["user"] or "")
    if ":" in user:
        raise BadInput(
            "The address of a robot must not contain a password.",
            "Use a key (ssh-copy-id user@host), kept by ssh-agent if it has a passphrase.",
        )
    if place["user"] is not None:
        _checked("user", user, _USER, address)
    host = _checked("host", unquote(place["host"].strip("[]")), _HOST, address)
    port = int(place["port"] or 0)
    if port > _MAX_PORT or (place["port"] and not port):
        raise BadInput(f"The port of {quoted(address)} is {place['port']}.", f"Give a port from 1 to {_MAX_PORT}.")
    return RobotAddress(kind="ssh", text=address, user=user, host=host, port=port)


def _checked(what: str, value: str, allowed: re.Pattern[str], address: str) -> str:
    if not allowed.fullmatch(value):
        shown = f"is {quoted(value)}" if value else "is missing"
        raise BadInput(
            f"The {what} of {quoted(address)} {shown}.",
            f"A {what} is made of letters, digits and a few signs such as - and _, and does not begin with a dash.",
        )
    return value


def _options(kind: str, query: str | None, address: str) -> dict[str, str | int]:
    """Parse the parameters after the question mark into fields."""
    found: dict[str, str | int] = {}
    for key, value in parse_qsl(query or "", keep_blank_values=True):
        if key in found:
            raise BadInput(f"{quoted(key)} occurs twice in {quoted(address)}.", "Give it once.")
        if key not in _KEYS[kind]:
            raise BadInput(
                f"{quoted(address)} has the unknown parameter {quoted(key)}.",
                f"Parameters of {kind} are: {', '.join(_KEYS[kind])}.",
            )
        if key == "container":
            found[key] = _checked("container", value, _CONTAINER, address)
        elif not (value.isascii() and value.isdigit() and int(value) <= MAX_DOMAIN_ID):
            raise BadInput(f"The domain_id of {quoted(address)} is {quoted(value)}.", f"From 0 to {MAX_DOMAIN_ID}.")
        else:
            found[key] = int(value)
    return found


def _is_login(text: str) -> bool:
    """Return whether the text looks like a login for ssh: `me@robot`, `robot.local`."""
    user, _, host = text.rpartition("@")
    return bool(_HOST.fullmatch(host)) and (not user or bool(_USER.fullmatch(user)))
