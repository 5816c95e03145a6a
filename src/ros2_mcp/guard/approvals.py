"""Approvals: a person consents to exactly one command, once, or grants one kind of command for a time (decision 31).

The model takes no part in an approval: its call is rejected until a person has approved it, and the model then repeats
the same call. Requests, approvals and grants are kept in memory only: a restart discards them.
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
"""The validity of an approval, in s: an agent that waits for it repeats its call within seconds."""
PENDING_S = 600.0
"""The lifetime of a waiting request, in s: an older request was made in a situation that has changed."""
DENIED_S = 60.0
"""The time during which a denied command is refused without asking again, in s: repeated questions must not wear a
person down."""
MOST_GRANT_S = 600.0
"""The longest duration of a grant, in s, unless the policy sets another maximum."""
MOST_PENDING = 8
"""The most waiting requests of one client: more than a person would read. A further request is refused; no waiting
request is dropped in its favour."""
_MOST_PENDING = 64
"""The most waiting requests of all clients together."""
_ID_LETTERS = "ABCDEFGHJKMNPQRSTUVWXYZ23456789"
"""Characters of an id: without I, L, O, 0 and 1, which are mistaken for one another when an id is read aloud."""
_ID_LENGTH = 4

State = Literal["waiting", "approved", "denied"]


@dataclass(slots=True, kw_only=True)
class Request:
    """A request for approval of one command: waiting, approved or denied.

    `nonce` identifies the request beyond its short `id`, so that an answer applies only to the request that the
    operator has read. `until` is the expiry time on the clock of `Approvals`, in s. `bounds` is a sentence about how
    the policy bounds the command. `by` is the operator who answered.
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
        """Return the lines about the request that an operator reads."""
        *told, client = self.exact.summary()
        return [*told, *filter(None, [self.bounds]), client]


@dataclass(frozen=True, slots=True, kw_only=True)
class Grant:
    """Permission for one kind of command for a time, without further approval: one client, one verb, name and type.

    `most` maps the path of a value to its largest allowed size: the absolute value of a number, the length of a vector,
    the largest element of a list. A grant can only narrow the policy, which is evaluated first.
    """

    id: str
    exact: ExactCommand
    until: float
    by: str
    most: Mapping[str, float] = field(default_factory=dict[str, float])

    def covers(self, exact: ExactCommand) -> bool:
        """Return whether the grant covers this command."""
        if exact.subject != self.exact.subject or exact.epoch != self.exact.epoch:
            return False
        sizes = ((_size_at(goal, path.split(".")), most) for goal in exact.goals for path, most in self.most.items())
        return all(size <= most for size, most in sizes)

    def in_words(self) -> str:
        """Return a description of the commands that the grant allows."""
        exact = self.exact
        bounds = "".join(f", {word(path)} at most {number(most)}" for path, most in self.most.items())
        return f"{exact.verb} {word(exact.name)} ({word(exact.type)}){bounds}"


@dataclass(frozen=True, slots=True, kw_only=True)
class RouteApproval:
    """The used approval of a list of goals, or of a single goal. It covers the goals until the job that sends them
    ends: a job sends a goal again after a pause.
    """

    id: str
    exact: ExactCommand

    def covers(self, exact: ExactCommand) -> bool:
        """Return whether this command is one of the list's goals."""
        mine = self.exact
        is_same = exact.route_id == mine.route_id and exact.subject == mine.subject and exact.epoch == mine.epoch
        return is_same and not exact.route and exact.digest in mine.goal_digests


class Approvals:
    """The waiting requests, the approvals that were not used yet, and the grants. Use it on one event loop only."""

    def __init__(
        self,
        *,
        valid_s: float = VALID_S,
        most_grant_s: float = MOST_GRANT_S,
        clock: Callable[[], float] | None = None,
        epoch: Callable[[], str] = str,
        changed: Callable[[str, Mapping[str, Any]], None] = lambda _, __: None,
    ) -> None:
        """Create an empty store of approvals.

        `changed` is called for the audit at each change, with a kind and the fields of the audit line. `epoch` returns
        the present epoch. Requests, approvals and grants lapse when it changes, so that after a stop each command needs
        a new approval.
        """
        self._valid_s = valid_s
        self._most_grant_s = most_grant_s
        self._clock = clock or _boot_time
        self.epoch = epoch
        self._changed = changed
        self._requests: dict[str, Request] = {}
        self._grants: dict[str, Grant] = {}
        self._routes: dict[str, RouteApproval] = {}

    # ── asked by the guard ─────────────────────────────────────────────────────────────────────────────────────────

    def require(self, exact: ExactCommand, bounds: str = "") -> str:
        """Consume the approval of exactly this command, or find a grant that covers it; return the id of either.

        `bounds` is a sentence about how the policy bounds the command, shown to the person who is asked.

        Raises:
            ApprovalNeeded: if there is neither; the request now waits for a person.
            Refused: if a person has just denied the command, or too many requests wait.
        """
        self._forget_lapsed()
        for grant in self._grants.values():
            if grant.covers(exact):
                return grant.id
        approved = self._routes.get(exact.route_id)
        if approved and approved.covers(exact):
            return approved.id
        request = self._requests.get(exact.key)
        if request and request.state == "approved":
            del self._requests[exact.key]  # before anything is sent, so that no other call can use it as well
            if exact.route_id:
                self._routes[exact.route_id] = RouteApproval(id=request.id, exact=exact)
            return request.id
        if request and request.state == "denied":
            raise Refused(
                "The operator denied this call: nothing was sent.",
                "Ask the operator why, or do something else.",
            )
        request = request or self._ask(exact, bounds)
        raise ApprovalNeeded(
            f"needs_approval {request.id}: this waits for a person; nothing was sent.",
            "Ask the operator to approve it with `ros2-mcp operate`, then repeat the call within "
            f"{self._valid_s:g} s. If a part of it has already succeeded, leave that part out. The approval "
            "is valid for one call.",
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

    def end_route(self, route_id: str) -> None:
        """End the approval of a list of goals: the job that sends them has ended."""
        self._routes.pop(route_id, None)

    def leave(self, principal: Principal) -> None:
        """Withdraw the waiting requests of a client that has disconnected."""
        for key, one in [*self._requests.items()]:
            if one.exact.principal == principal and one.state == "waiting":
                del self._requests[key]
                self._changed("withdrawn", {"approval": one.id, "reason": "its client has gone"})

    # ── asked by an operator ───────────────────────────────────────────────────────────────────────────────────────

    def waiting(self) -> Sequence[Request]:
        """Return the requests that wait for a person, oldest first."""
        self._forget_lapsed()
        return [one for one in self._requests.values() if one.state == "waiting"]

    def grants(self) -> Sequence[Grant]:
        """Return the grants in force."""
        self._forget_lapsed()
        return [*self._grants.values()]

    def seconds_left(self, one: Request | Grant) -> float:
        """Return how long the request or grant remains valid, in s."""
        return max(0.0, one.until - self._clock())

    def age_s(self, request: Request) -> float:
        """Return how long ago the request was made, in s."""
        return self._clock() - request.asked_at

    def find(self, request_id: str, nonce: str = "") -> Request:
        """Return the waiting request with this id; with a `nonce`, only if the nonce matches as well.

        Raises:
            NotFound: if no such request waits.
        """
        for request in self.waiting():
            if request.id == request_id.upper() and (not nonce or secrets.compare_digest(request.nonce, nonce)):
                return request
        raise NotFound(f"No request {word(request_id)} waits: it was answered, has lapsed, or a stop ended it.")

    def approve(self, request_id: str, nonce: str = "", *, by: str) -> Request:
        """Approve the request: its command may be sent once, within the time that approvals are valid. Raises
        `NotFound`.
        """
        request = self.find(request_id, nonce)
        request.state, request.by, request.until = "approved", by, self._clock() + self._valid_s
        self._changed("approved", {"approval": request.id, "by": by, "digest": request.exact.digest})
        return request

    def deny(self, request_id: str, nonce: str = "", *, by: str) -> Request:
        """Deny the request, and refuse the same command for a while. Raises `NotFound`."""
        request = self.find(request_id, nonce)
        request.state, request.by, request.until = "denied", by, self._clock() + DENIED_S
        self._changed("denied", {"approval": request.id, "by": by, "digest": request.exact.digest})
        return request

    def grant(
        self, request_id: str, for_s: float, most: Mapping[str, float] | None = None, *, nonce: str = "", by: str
    ) -> Grant:
        """Approve the waiting command and grant its kind for a time, within the policy.

        Args:
            request_id: the id of the waiting request.
            for_s: the duration of the grant, in s.
            most: maps the path of a value to its largest size.
            nonce: the nonce of the request, as in `find`.
            by: the operator who grants it.

        Raises:
            NotFound: if no such request waits.
            BadInput: if the duration is too long, or if a bound is no number, names no number, or excludes the waiting
                command.
        """
        request = self.find(request_id, nonce)
        if not 0 < for_s <= self._most_grant_s:
            raise BadInput(f"A grant lasts more than 0 and at most {self._most_grant_s:g} s.")
        bounds = dict(most or {})
        for path, value in bounds.items():
            if not (math.isfinite(value) and value >= 0):
                raise BadInput(f"The bound of {path} is not a number from 0 on.")
            if not math.isfinite(_size_at(request.exact.value, path.split("."))):
                raise BadInput(
                    f"The waiting request has no number at {word(path)}.", "Name a value that operate show lists."
                )
        grant = Grant(id=self._fresh_id(), exact=request.exact, until=self._clock() + for_s, by=by, most=bounds)
        if not grant.covers(request.exact):
            raise BadInput("The waiting request exceeds that bound.", "Raise it, or deny the request.")
        del self._requests[request.exact.key]
        self._grants[grant.id] = grant
        self._changed(
            "granted", {"approval": grant.id, "by": by, "for_s": for_s, "what": grant.in_words(), "of": request.id}
        )
        return grant

    def revoke(self, grant_id: str, *, by: str) -> Grant:
        """End a grant. Raises `NotFound`."""
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
    """Return the time of a monotonic clock that also runs while the machine sleeps, in s: an approval must not survive
    a sleep.
    """
    if sys.platform == "linux":
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    if sys.platform == "darwin":  # where CLOCK_MONOTONIC counts sleep, and time.monotonic() does not
        return time.clock_gettime(time.CLOCK_MONOTONIC)
    return time.monotonic()


def _size_at(value: Any, path: Sequence[str]) -> float:
    """Return the size of the value at a path; infinite if there is no value, or it has no size."""
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
