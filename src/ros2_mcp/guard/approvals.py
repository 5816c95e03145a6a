"""Approvals: a person allows one act, exactly that one, once; or grants a kind of act for a time (decision 31).

The model takes no part: it makes a call, is told that a person has to approve it, and makes the same call again. All is
kept in memory: a restart forgets what was approved.
"""

from __future__ import annotations

import math
import secrets
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast

from ros2_mcp.guard.exact import ExactCommand, number, word
from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import ApprovalNeeded, BadInput, NotFound, Refused

VALID_S = 60.0
"""From the approval to the call: an agent that waits for it calls within seconds."""
PENDING_S = 600.0
"""How long a request waits for a person: what is older was asked in another situation."""
DENIED_S = 60.0
"""How long the same act is refused without asking again: a person must not be worn down by the same question."""
MOST_GRANT_S = 600.0
"""Unless the policy says otherwise."""
MOST_PENDING = 8
"""Of one client: more than a person would read. What is more is refused; nothing that waits is pushed out."""
_MOST_PENDING = 64
"""Of all clients."""
_ID_LETTERS = "ABCDEFGHJKMNPQRSTUVWXYZ23456789"
"""Without those that are taken for another one when they are read aloud."""
_ID_LENGTH = 4

State = Literal["waiting", "approved", "denied"]


@dataclass(slots=True, kw_only=True)
class Request:
    """An act that waits for a person, or has its answer. `nonce` is what an answer must name beside the short `id`.

    `until` is when it lapses, on the clock of `Approvals`; `bounds` the sentence about what the policy bounds of it;
    `by` is who answered.
    """

    id: str
    nonce: str
    exact: ExactCommand
    asked_at: float
    until: float
    bounds: str = ""
    state: State = "waiting"
    by: str = ""

    def summary(self) -> list[str]:
        """What a person reads of it."""
        *told, client = self.exact.summary()
        return [*told, *filter(None, [self.bounds]), client]


@dataclass(frozen=True, slots=True, kw_only=True)
class Grant:
    """Acts of one kind that need no approval for a time: those of one client, with one verb, name and type.

    `most` bounds the size of what is at a path: the length of a vector, the largest of a list, all numbers below. It
    can only be narrower than the policy, which is asked first.
    """

    id: str
    exact: ExactCommand
    until: float
    by: str
    most: Mapping[str, float] = field(default_factory=dict[str, float])

    def covers(self, exact: ExactCommand) -> bool:
        """Whether this act needs no other approval."""
        if exact.subject != self.exact.subject or exact.epoch != self.exact.epoch:
            return False
        return all(_size_at(exact.value, path.split(".")) <= most for path, most in self.most.items())

    def in_words(self) -> str:
        """What it allows."""
        exact = self.exact
        bounds = "".join(f", {word(path)} at most {number(most)}" for path, most in self.most.items())
        return f"{exact.verb} {word(exact.name)} ({word(exact.type)}){bounds}"


class Approvals:
    """What waits for a person, what was approved and not used yet, and what is granted. Use it on one event loop."""

    def __init__(
        self,
        *,
        valid_s: float = VALID_S,
        most_grant_s: float = MOST_GRANT_S,
        clock: Callable[[], float] | None = None,
        epoch: Callable[[], str] = str,
        changed: Callable[[str, Mapping[str, Any]], None] = lambda _, __: None,
    ) -> None:
        """`changed` is told of everything that happens, for the audit: a kind and the fields of its line. What was
        asked, approved or granted lapses with its `epoch`: after a stop a person begins anew.
        """
        self._valid_s = valid_s
        self._most_grant_s = most_grant_s
        self._clock = clock or _boot_time
        self.epoch = epoch
        self._changed = changed
        self._requests: dict[str, Request] = {}
        self._grants: dict[str, Grant] = {}

    # ── asked by the guard ─────────────────────────────────────────────────────────────────────────────────────────

    def require(self, exact: ExactCommand, bounds: str = "") -> str:
        """Uses up the approval of exactly this act, or a grant that covers it; returns its id.

        `bounds` is the sentence about what the policy bounds of it, for the person who is asked.

        Raises:
            ApprovalNeeded: if there is none yet; a person can see it now.
            Refused: if it was denied a moment ago, or too many wait.
        """
        self._forget_lapsed()
        for grant in self._grants.values():
            if grant.covers(exact):
                return grant.id
        request = self._requests.get(exact.key)
        if request and request.state == "approved":
            del self._requests[exact.key]  # before anything is sent: no other call can use it, too
            return request.id
        if request and request.state == "denied":
            raise Refused(
                "The operator denied this call: nothing was sent.",
                "Ask the operator why, or do something else.",
            )
        request = request or self._ask(exact, bounds)
        raise ApprovalNeeded(
            f"needs_approval {request.id}: this waits for a person; nothing was sent.",
            "Tell the operator, who runs `ros2-mcp operate`. Once approved, repeat the same call within "
            f"{self._valid_s:g} s, without what was already done; it is carried out once.",
            request_id=request.id,
        )

    def _ask(self, exact: ExactCommand, bounds: str) -> Request:
        waiting = [one for one in self._requests.values() if one.state == "waiting"]
        own = sum(one.exact.principal.counted_as == exact.principal.counted_as for one in waiting)
        if own >= MOST_PENDING or len(waiting) >= _MOST_PENDING:
            whose = "of your requests" if own >= MOST_PENDING else "requests of all clients"
            many = own if own >= MOST_PENDING else len(waiting)
            raise Refused(f"{many} {whose} wait for a person: nothing was sent.", "Wait for the answers.")
        now = self._clock()
        nonce = secrets.token_hex(16)
        request = Request(
            id=self._fresh_id(), nonce=nonce, exact=exact, asked_at=now, until=now + PENDING_S, bounds=bounds
        )
        self._requests[exact.key] = request
        self._changed("asked", {"approval": request.id, **exact.line()})
        return request

    def leave(self, principal: Principal) -> None:
        """Forgets what waits of a client that has gone."""
        for key, one in [*self._requests.items()]:
            if one.exact.principal == principal and one.state == "waiting":
                del self._requests[key]
                self._changed("withdrawn", {"approval": one.id, "reason": "its client has gone"})

    # ── asked by an operator ───────────────────────────────────────────────────────────────────────────────────────

    def waiting(self) -> Sequence[Request]:
        """What waits for a person, the oldest first."""
        self._forget_lapsed()
        return [one for one in self._requests.values() if one.state == "waiting"]

    def grants(self) -> Sequence[Grant]:
        """What is granted now."""
        self._forget_lapsed()
        return [*self._grants.values()]

    def seconds_left(self, one: Request | Grant) -> float:
        """How long a request or a grant still holds."""
        return max(0.0, one.until - self._clock())

    def age_s(self, request: Request) -> float:
        """How long ago it was asked."""
        return self._clock() - request.asked_at

    def find(self, request_id: str, nonce: str = "") -> Request:
        """The request of that id that waits; with a `nonce`, only the very one that an operator has read.

        Raises:
            NotFound: if none waits under that id.
        """
        for request in self.waiting():
            if request.id == request_id.upper() and (not nonce or secrets.compare_digest(request.nonce, nonce)):
                return request
        raise NotFound(f"No request {word(request_id)} waits: it was answered, has lapsed, or a stop ended it.")

    def approve(self, request_id: str, nonce: str = "", *, by: str) -> Request:
        """Allows it, once, from now on for the time that approvals are valid. Raises `NotFound`."""
        request = self.find(request_id, nonce)
        request.state, request.by, request.until = "approved", by, self._clock() + self._valid_s
        self._changed("approved", {"approval": request.id, "by": by, "digest": request.exact.digest})
        return request

    def deny(self, request_id: str, nonce: str = "", *, by: str) -> Request:
        """Refuses it, and the same act for a while. Raises `NotFound`."""
        request = self.find(request_id, nonce)
        request.state, request.by, request.until = "denied", by, self._clock() + DENIED_S
        self._changed("denied", {"approval": request.id, "by": by, "digest": request.exact.digest})
        return request

    def grant(
        self, request_id: str, for_s: float, most: Mapping[str, float] | None = None, *, nonce: str = "", by: str
    ) -> Grant:
        """Allows what waits, and its kind for a time, as far as the policy allows it.

        Args:
            request_id: of what waits.
            for_s: seconds from now on.
            most: path of a value → its largest size.
            nonce: as `find` takes it.
            by: who grants it.

        Raises:
            NotFound: if none waits under that id.
            BadInput: if it lasts too long, or a bound is no number or does not allow what waits.
        """
        request = self.find(request_id, nonce)
        if not 0 < for_s <= self._most_grant_s:
            raise BadInput(f"A grant lasts {self._most_grant_s:g} s at most, and longer than 0.")
        bounds = dict(most or {})
        for path, value in bounds.items():
            if not (math.isfinite(value) and value >= 0):
                raise BadInput(f"The bound of {path} is no number from 0 on.")
            if not math.isfinite(_size_at(request.exact.value, path.split("."))):
                raise BadInput(f"What waits has no number at {word(path)}.", "Name a value that operate show has.")
        grant = Grant(id=self._fresh_id(), exact=request.exact, until=self._clock() + for_s, by=by, most=bounds)
        if not grant.covers(request.exact):
            raise BadInput("What waits is beyond that bound.", "Raise it, or deny the request.")
        del self._requests[request.exact.key]
        self._grants[grant.id] = grant
        self._changed(
            "granted", {"approval": grant.id, "by": by, "for_s": for_s, "what": grant.in_words(), "of": request.id}
        )
        return grant

    def revoke(self, grant_id: str, *, by: str) -> Grant:
        """Ends a grant. Raises `NotFound`."""
        self._forget_lapsed()
        grant = self._grants.pop(grant_id.upper(), None)
        if grant is None:
            raise NotFound(f"There is no grant {word(grant_id)}.")
        self._changed("revoked", {"approval": grant.id, "by": by})
        return grant

    def _forget_lapsed(self) -> None:
        now, epoch = self._clock(), self.epoch()

        def holds(one: Request | Grant) -> bool:
            return now < one.until and one.exact.epoch == epoch

        self._requests = {key: one for key, one in self._requests.items() if holds(one)}
        self._grants = {key: one for key, one in self._grants.items() if holds(one)}

    def _fresh_id(self) -> str:
        used = {one.id for one in self._requests.values()} | self._grants.keys()
        while True:
            made = "".join(secrets.choice(_ID_LETTERS) for _ in range(_ID_LENGTH))
            if made not in used:
                return made


def _boot_time() -> float:
    """A steady clock that also counts while the machine sleeps: an approval must not wake up with it."""
    if sys.platform == "linux":
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    if sys.platform == "darwin":  # where this one counts it, and Python's own does not
        return time.clock_gettime(time.CLOCK_MONOTONIC)
    return time.monotonic()


def _size_at(value: Any, path: Sequence[str]) -> float:
    """The size of what is at a path; infinite where there is nothing, or something that is no number."""
    for part in path:
        if not isinstance(value, Mapping) or part not in value:
            return math.inf
        value = cast("Mapping[str, Any]", value)[part]
    return _size(value)


def _size(value: Any) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return abs(value) if math.isfinite(value) else math.inf
    if isinstance(value, Mapping):
        return math.hypot(*map(_size, cast("Mapping[str, Any]", value).values()))
    if isinstance(value, (list, tuple)):
        return max(map(_size, cast("Sequence[Any]", value)), default=0.0)
    return math.inf
