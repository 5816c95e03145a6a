"""Tokens for access over HTTP, each with a name and scopes.

A server has a token of its own, made at the first start and kept in the state folder, or the tokens of a file. Tokens
are compared by their SHA-256; a file of tokens has only the hashes.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import stat
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp_common.files import PLAIN, is_of_others

SCOPES = ("observe", "act", "stop")
"""The scopes of a token: reading; everything that changes something; and `ros2_stop`, which `act` includes."""
LOGIN = "ros2_mcp.mcp.transports.http.login"
"""The key of an ASGI scope that holds the request's `Login`; missing if no login is required."""
OWN_NAME = "own"
"""The name of the token that a server makes for itself."""

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,40}")
_DIGEST = re.compile(r"sha256:([0-9a-f]{64})")
_TOKEN_BYTES = 32
"""The length of a token: 256 random bits, which cannot be guessed."""
_MOST_FILE_BYTES = 1_000_000
"""The largest file of tokens, in bytes: ten thousand tokens. More users need another kind of login."""
_HEAD = (
    "# Tokens of ros2-mcp: name, scopes, SHA-256 of the token. Add one with: ros2-mcp --token-file FILE token NAME\n"
)


@dataclass(frozen=True, slots=True)
class Login:
    """The origin of a request: the name and the scopes of its token."""

    name: str
    scopes: frozenset[str]


ALL = frozenset(SCOPES)


def may(scopes: frozenset[str], risk: str) -> str:
    """Return the scope that is missing for a tool with that risk; "" if none is."""
    if risk == "read":
        return "" if "observe" in scopes else "observe"
    if risk == "stop":
        return "" if scopes & {"stop", "act"} else "stop"
    return "" if "act" in scopes else "act"


class Tokens:
    """The accepted tokens: a login for the SHA-256 of each token."""

    def __init__(self, logins: Mapping[bytes, Login]) -> None:
        self._logins = dict(logins)

    def __len__(self) -> int:
        return len(self._logins)

    def login(self, presented: bytes) -> Login | None:
        """Return the login of a token, or None. The comparison takes the same time for every token."""
        digest, found = hashlib.sha256(presented).digest(), None
        for known, login in self._logins.items():
            if hmac.compare_digest(known, digest):
                found = login
        return found


def own_tokens(folder: Path) -> Tokens:
    """Return the server's own token alone, with all scopes."""
    token, _ = own_token(folder)
    return Tokens({hashlib.sha256(token.encode()).digest(): Login(OWN_NAME, ALL)})


def own_token(folder: Path) -> tuple[str, bool]:
    """Return the server's own token, and whether it was created now.

    Raises:
        BadInput: if it can be neither read nor created, or other users could read it.
    """
    path = folder / "http-token"
    try:
        is_new = not path.exists() and _make(path)
        return _secret(path), is_new
    except OSError as error:
        raise BadInput(
            f"The token of this server cannot be kept in {path}: {error.strerror}.",
            "Give XDG_STATE_HOME a folder that can be written to, or use --token-file.",
        ) from error


def read_tokens(path: Path) -> Tokens:
    """Read a file of tokens: one line for each, with name, scopes and SHA-256.

    Raises:
        BadInput: if the file cannot be read or could be changed by other users, or a line is invalid (with its number).
    """
    logins: dict[bytes, Login] = {}
    for number, line in enumerate(_lines(path), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            digest, login = _entry(words)
        except BadInput as error:
            raise BadInput(f"{path}, line {number}: {error.message}", error.hint) from None
        if digest in logins or any(login.name == other.name for other in logins.values()):
            raise BadInput(f"{path}, line {number}: {login.name} or its token occurs twice.")
        logins[digest] = login
    if not logins:
        raise BadInput(f"{path} has no token.", f"Add one: ros2-mcp --token-file {path} token NAME")
    return Tokens(logins)


def add_token(path: Path, name: str, scopes: Sequence[str]) -> str:
    """Add a token to the file (created if necessary), and return the token. The token itself is not stored.

    Raises:
        BadInput: for an invalid name or scope, a name that exists already, or a file that cannot be used.
    """
    token = secrets.token_urlsafe(_TOKEN_BYTES)
    line = [name, ",".join(scopes), f"sha256:{hashlib.sha256(token.encode()).hexdigest()}"]
    _entry(line)
    lines = _lines(path) if path.exists() else []
    if any(kept.split()[:1] == [name] for kept in lines):
        raise BadInput(f"{path} has a token {name} already.", "Delete its line, or choose another name.")
    # A hand-edited file may lack a newline at its end.
    before = _HEAD if not lines else "" if lines[-1].endswith("\n") else "\n"
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600), "a", encoding="utf-8") as file:
            file.write(before + " ".join(line) + "\n")
    except OSError as error:
        raise BadInput(f"{path} cannot be written: {error.strerror}.") from error
    return token


def _entry(words: Sequence[str]) -> tuple[bytes, Login]:
    if len(words) != 3 or not _NAME.fullmatch(words[0]):
        raise BadInput(
            f"{' '.join(words)!r} is not a token.",
            "A line has a name (letters, digits, _ . -), scopes with commas between them, and sha256:… of the token.",
        )
    scopes = words[1].split(",")
    for scope in scopes:
        if scope not in SCOPES:
            raise BadInput(
                f"There is no scope {scope!r}.", did_you_mean(scope, SCOPES, f"There are {', '.join(SCOPES)}.")
            )
    digest = _DIGEST.fullmatch(words[2])
    if not digest:
        raise BadInput(f"The token of {words[0]} is not kept as sha256: and 64 hexadecimal digits.")
    return bytes.fromhex(digest[1]), Login(words[0], frozenset(scopes))


def _lines(path: Path) -> list[str]:
    try:
        with path.open("rb") as file:
            _refuse_others(path, os.fstat(file.fileno()), stat.S_IWGRP | stat.S_IWOTH, "changed")
            return file.read(_MOST_FILE_BYTES).decode("utf-8", "replace").splitlines(keepends=True)
    except OSError as error:
        raise BadInput(f"The tokens {path} cannot be read: {error.strerror}.") from error


def _make(path: Path) -> bool:
    """Write a new token unless another server has just done so; return whether this call did."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    beside = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        file.write(secrets.token_urlsafe(_TOKEN_BYTES) + "\n")
    try:
        os.link(beside, path)  # does not replace an existing file
    except FileExistsError:
        return False
    finally:
        beside.unlink()
    return True


def _secret(path: Path) -> str:
    with os.fdopen(os.open(path, os.O_RDONLY | PLAIN | getattr(os, "O_NONBLOCK", 0)), "rb") as file:
        _refuse_others(path, os.fstat(file.fileno()), stat.S_IRWXG | stat.S_IRWXO, "read")
        token = file.read(1000).decode("ascii", "replace").strip()
    if len(token) < _TOKEN_BYTES:
        raise BadInput(f"{path} holds no token.", "Delete it: the next start makes a new one.")
    return token


def _refuse_others(path: Path, found: os.stat_result, bits: int, what: str) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise BadInput(f"{path} is not a file.")
    if is_of_others(found) or (sys.platform != "win32" and found.st_mode & bits):
        raise BadInput(f"{path} can be {what} by others.", f"Make it yours alone: chmod 600 {path}")
