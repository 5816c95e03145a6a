"""The operator's terminal: a plain screen of requests that wait for approval.

Each of its actions is also a subcommand, for scripts.
"""

from __future__ import annotations

import json
import shutil
import sys
import textwrap
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ros2_mcp.commands.keys import DOWN, UP, Restored, key, single_keys
from ros2_mcp.guard.audit import Audit
from ros2_mcp.guard.consent import audit_folder
from ros2_mcp.guard.operating import RESET
from ros2_mcp.guard.operators import name_of, own_uid
from ros2_mcp.guard.servers import Ended, Row, Server, servers_in
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadInput, NotFound, Refused, RobotError
from ros2_mcp.model.text import visible
from ros2_mcp_common.latch import ResetRefused

_REFRESH_S = 0.5
"""Time between two refreshes of the screen: a request is seen at once, and the screen does not flicker."""
_SETTLED_S = 0.7
"""The shortest time on the screen before a key can answer a request: a newer request cannot have been read."""
_KEYS = "↑↓ choose  a approve  d deny  g grant for a time  s STOP  r reset the latch  m mode  q quit"
_STEPS = ("list", "show", "approve", "deny", "grant", "revoke", "mode", "stop", "reset")


def folder_of(folder: Path) -> Path:
    """Return the state folder of the robot whose server is found from this folder; without a server, this folder
    itself.

    Raises:
        BadInput: if links lead to several robots.
    """
    try:
        servers = servers_in(folder)
    except NotFound:
        return folder
    for server in servers:
        server.close()
    return servers[0].folder


def operate(folder: Path, step: str = "", arguments: Sequence[str] = (), *, as_json: bool = False) -> int:
    """Run one step; without a step, the screen.

    Args:
        folder: the state folder of the robot.
        step: the step, such as `approve`.
        arguments: the arguments of the step, such as the id of a request.
        as_json: print the answers as JSON.

    Raises:
        RobotError: if there is no server, or the step fails.
    """
    try:
        servers = servers_in(folder)
    except NotFound:
        if step != "reset":
            raise
        _print([{"ok": True, "done": reset(folder)}], as_json)
        return 0
    try:
        if not step and sys.stdin.isatty() and sys.stdout.isatty():
            Screen(servers).run()
            return 0
        answers = _step(servers, step or "list", list(arguments))
    finally:
        for server in servers:
            server.close()
    _print(answers, as_json)
    return 0


def _print(answers: Sequence[Row], as_json: bool) -> None:
    for answer in answers:
        if as_json:
            print(json.dumps(answer))  # noqa: T201
        else:
            lines = [str(answer["done"])] if "done" in answer else shown(answer)
            print("\n".join(map(visible, lines)))  # noqa: T201


def reset(folder: Path) -> str:
    """Reset the latch of a robot without a running server, and note it in the audit. Return a message.

    Raises:
        RobotError: if the folder belongs to another user, or the latch was set again meanwhile.
    """
    latch = StateFolder(folder).latch()
    state = latch.look()
    if not state.is_set:
        return f"The latch of {folder.name} is not set. Another robot: ros2-mcp --policy FILE operate, or --state DIR."
    if folder.stat().st_uid != own_uid():  # otherwise the server could not write files that this user creates
        owner = name_of(folder.stat().st_uid)
        raise Refused(
            "Without a server, only the user who owns its files can reset the latch.",
            f"Run this as {owner}, or start the server.",
        )
    by, log = f"operator {name_of(own_uid())}", Audit(lambda: audit_folder(StateFolder(folder)))
    try:
        latch.reset(by=by, seen=state.count)
        log.note("reset", by=by, was=state.reason, count=state.count)
    except ResetRefused as error:
        raise RobotError(f"The latch was not reset: {error}.") from error
    finally:
        log.close()
    unwritten = f" The audit does not tell it: {log.failed}." if log.failed else ""
    return f"{folder.name}: {RESET} It was set by {state.by}: {state.reason}.{unwritten}"


def _step(servers: Sequence[Server], step: str, words: list[str]) -> list[Row]:
    """Return the answers of all servers, or of the server with the given request. Raises `RobotError`."""
    if step not in _STEPS:
        raise BadInput(f"There is no step called {step!r}.", f"Choose from {', '.join(_STEPS)}.")
    if step in ("list", "stop", "reset"):
        return [server.do(step) for server in servers]
    if not words:
        raise BadInput(f"{step} what?", "Give the id that the list shows, or the name of the mode.")
    if step == "mode":
        return [server.do(step, mode=words[0]) for server in servers]
    more: dict[str, Any] = {"id": words[0]}
    if step == "grant":
        more |= granted(words[1:])
    failed: RobotError = NotFound("There is no server.")
    for server in servers:
        try:
            return [server.do(step, **more)]
        except RobotError as error:
            failed = error
    raise failed


def granted(words: Sequence[str]) -> dict[str, Any]:
    """Parse the duration and the bounds of a grant: `600`, `10m`, `linear=0.2`. Raises `BadInput`."""
    for_s, most = 0.0, dict[str, float]()
    for text in words:
        path, is_bound, number = text.partition("=")
        try:
            if is_bound:
                most[path] = float(number)
            else:
                factor = 60.0 if text.endswith("m") else 1.0
                for_s = float(text.rstrip("ms")) * factor
        except ValueError:
            raise BadInput(f"{text!r} is neither a time nor a bound.", "Such as: 10m linear=0.2") from None
    if not for_s:
        raise BadInput("For how long?", "Give seconds or minutes, such as 600 or 10m.")
    return {"for_s": for_s, "most": most}


# ── the lines of the screen ──────────────────────────────────────────────────────────────────────────────────────────


def shown(state: Row, width: int = 100, chosen: str = "") -> list[str]:
    """Return the state of one server as lines: the robot's state, then the waiting requests, the oldest first."""
    if "request" in state:
        return [*_request(state["request"], width, chosen), *json.dumps(state["value"], indent=2).splitlines()]
    lines = [_standing(state)]
    if (moves := state.get("moves")) is not None:
        lines.append(f"moves the robot now: {', '.join(moves)}" if moves else "moves nothing now")
    if latch := state["latch"]:
        ago = max(0.0, time.time() - latch["since"])
        lines.append(f"LATCHED {_ago(ago)} ago by {latch['by']}: {latch['reason']}")
    if failed := state["audit"]["failed"]:
        lines.append(f"THE AUDIT CANNOT BE WRITTEN: {failed}")
    lines = [part for line in lines for part in _wrapped(line, width)]
    lines.append("─" * width)
    for request in state["waiting"]:
        lines += [*_request(request, width, chosen), ""]
    if not state["waiting"]:
        lines += ["Nothing waits for approval.", ""]
    for one in state["grants"]:
        lines += _wrapped(f"granted {one['id']}, {one['left_s']:.0f} s left: {one['what']}", width)
    return lines


def _wrapped(line: str, width: int) -> list[str]:
    """Return a line wrapped to the width: text on which a person decides is never cut."""
    return textwrap.wrap(visible(line), width, subsequent_indent="    ", break_on_hyphens=False)


def _standing(state: Row) -> str:
    mode = f"mode {state['mode']}" if state["mode"] else "no policy: nothing needs approval"
    waiting = len(state["waiting"])
    return f"{state['robot']}   {mode}   {waiting} waiting   audit {state['audit']['head']}"


def _request(request: Row, width: int, chosen: str) -> list[str]:
    mark = "▶" if request["id"] == chosen else " "
    head = f"{mark} {request['id']}   asked {_ago(request['age_s'])} ago, {request['left_s']:.0f} s left"
    below = [
        line for text in request["summary"] for line in textwrap.wrap(text, width - 4, break_on_hyphens=False) or [""]
    ]
    return [head, *(f"    {line}" for line in below)]


def _ago(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


@dataclass(slots=True)
class Choice:
    """The chosen request, which keys answer, and since when it has been chosen (monotonic clock, s).

    Only a key chooses a request, even after the chosen one has gone: a key pressed twice answers one request only.
    """

    chosen: Row = field(default_factory=dict[str, Any])
    since: float = 0.0

    def follow(self, waiting: Sequence[Row], now: float) -> None:
        """Keep the chosen request as long as it waits."""
        if not any(one["nonce"] == self.chosen.get("nonce") for one in waiting):
            self._choose({}, now)

    def move(self, waiting: Sequence[Row], by: int, now: float) -> None:
        """Choose the next or the previous request."""
        if waiting:
            nonces = [one["nonce"] for one in waiting]
            at = nonces.index(self.chosen["nonce"]) if self.chosen.get("nonce") in nonces else -1 if by > 0 else 0
            self._choose(waiting[(at + by) % len(waiting)], now)

    def is_read(self, now: float) -> bool:
        """Return whether the request was chosen long enough to have been read."""
        return bool(self.chosen) and now - self.since >= _SETTLED_S

    def _choose(self, request: Row, now: float) -> None:
        self.chosen, self.since = request, now


class Screen:
    """The interactive terminal."""

    def __init__(self, servers: Sequence[Server]) -> None:
        self._servers = [*servers]
        self._choice = Choice()
        self._on_page: Sequence[Row] = ()
        self._said = ""

    def run(self) -> None:
        """Run until `q` is pressed. Raises `Ended` when the last server has ended."""
        with single_keys() as restored:
            while True:
                states = self._states()
                self._draw(states)
                pressed = key(_REFRESH_S)
                if pressed == "q":
                    return
                if pressed:
                    try:
                        self._said = self._press(pressed, states, restored) or self._said
                    except (RobotError, ValueError) as error:
                        self._said = str(error)

    def _states(self) -> list[Row]:
        states: list[Row] = []
        for server in [*self._servers]:
            try:
                states.append(server.do("list"))
            except Ended:
                self._servers.remove(server)
        if not states:
            raise Ended
        return states

    def _draw(self, states: Sequence[Row]) -> None:
        width, height = shutil.get_terminal_size()
        waiting = [one for state in states for one in state["waiting"]]
        lines: list[str] = []
        chosen = str(self._choice.chosen.get("id", ""))
        for state in states:
            lines += shown(state, width, chosen)
        said = _wrapped(self._said, width) or [""]
        room = max(height - 2 - len(said), 1)
        more = [f"… and {len(lines) - room + 1} more lines: answer these first"] if len(lines) > room else []
        lines = [*lines[: room - len(more)], *more]
        self._on_page = [one for one in waiting if {*_request(one, width, chosen)} <= {*lines}]
        self._choice.follow(self._on_page, time.monotonic())
        page = [*lines, *[""] * (room - len(lines)), *said, _KEYS]
        text = "\r\n".join(visible(line)[:width] for line in page)
        sys.stdout.write(f"\x1b[H\x1b[2J{text}")
        sys.stdout.flush()

    def _press(self, key: str, states: Sequence[Row], restored: Restored) -> str:
        now = time.monotonic()
        if key in (UP, DOWN, "k", "j"):
            self._choice.move(self._on_page, -1 if key in (UP, "k") else 1, now)
            return " "
        if key == "s":
            return " ".join(str(server.do("stop")["done"]) for server in self._servers)
        if key == "r":
            return " ".join(
                str(server.do("reset", seen=state["latch"]["count"])["done"])
                for server, state in zip(self._servers, states, strict=True)
                if state["latch"]
            )
        if key == "m":
            with restored():
                mode = input("\r\nmode (observe, confirm, autonomous): ").strip()
            return " ".join(str(server.do("mode", mode=mode)["done"]) for server in self._servers) if mode else ""
        if key in "adg":
            return self._answer(key, states, now, restored)
        return ""

    def _answer(self, key: str, states: Sequence[Row], now: float, restored: Restored) -> str:
        if not self._choice.is_read(now):
            return "Read it first." if self._choice.chosen else "Nothing is chosen: ↓ chooses."
        request = self._choice.chosen
        server = next(
            server
            for server, state in zip(self._servers, states, strict=True)
            if any(one["nonce"] == request["nonce"] for one in state["waiting"])
        )
        named = {"id": request["id"], "nonce": request["nonce"]}
        if key != "g":
            return str(server.do("approve" if key == "a" else "deny", **named)["done"])
        with restored():
            words = input("\r\ngrant for how long, and up to what (such as 10m linear=0.2): ").split()
        return str(server.do("grant", **named, **granted(words))["done"]) if words else ""
