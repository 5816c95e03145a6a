"""One request of the server with its arguments checked, and the error that answers a request that failed."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, Union, cast

from ros2_mcp_common.wire.limits import MAX_RATE_HZ, MIN_RATE_HZ

if TYPE_CHECKING:
    from ros2_mcp_bridge.epoch import Acceptance
    from ros2_mcp_common.wire.protocol import EndedBy, ErrorKind, Failure

T = TypeVar("T")

Steps = Generator[float, None, T]
"""What an operation that waits is: it yields the seconds after which it wants to go on, and returns its result."""

Answer = Union[Mapping[str, object], "tuple[Mapping[str, object], bytes]", None]
"""The `ok` part of an answer, with a body where there is one; None where the answer is sent by other means."""


class OperationError(Exception):
    """Answers a request with an error."""

    def __init__(self, kind: ErrorKind, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.kind: ErrorKind = kind
        self.message = message
        self.hint = hint

    def as_json(self) -> Failure:
        """The `error` part of the answer."""
        return {"kind": self.kind, "message": self.message, "hint": self.hint}


_WHY_ENDED: Mapping[EndedBy, tuple[ErrorKind, str]] = {
    "cancel": ("cancelled", "The request was cancelled"),
    "stop": ("stopped", "A stop came after this was accepted"),
    "lease": ("lapsed", "The server was silent for longer than its link lease"),
    "latch": ("latched", "The latch of this robot is set, or was since this was accepted; only an operator resets it"),
    "stopper": ("stopped", "The stopper died, and what moved was stopped"),
}


class Cancelled(OperationError):
    """Thrown into an operation that is ended before its time, with what ended it and what of it was sent."""

    def __init__(self, ended_by: EndedBy = "cancel", sent: str = "nothing was sent") -> None:
        kind, why = _WHY_ENDED[ended_by]
        super().__init__(kind, f"{why}: {sent}.")
        self.ended_by: EndedBy = ended_by


class Work(Protocol):
    """What works on a request: a `Task` of the loop."""

    def wake(self) -> None:
        """Let it go on at once."""
        ...

    def throw(self, error: Exception) -> None:
        """Raise an exception where it waits."""
        ...


class Request:
    """A request: `id`, `op`, `body`, and arguments that raise `OperationError` of kind `bad_request` when wrong.

    `interface` is the Python class of the argument `type`, where there is one; `task` is what works on the request, as
    long as it can be cancelled. One that acts has an `acceptance`; `has_left` as soon as something of it was sent.
    `ended` is how many others it has ended.
    """

    def __init__(self, header: Mapping[str, Any], body: bytes) -> None:
        number = header.get("id")
        self.id: int | None = number if isinstance(number, int) else None  # NaN is no JSON: it could not be answered
        self.op: str = header.get("op") or ""
        self.body = body
        self.acceptance: Acceptance | None = None
        self.has_left = False
        self.ended = 0
        self.interface: Any = None
        self.task: Work | None = None
        self._header = header

    def wake(self) -> None:
        """Let the operation look again at once at what it waits for."""
        if self.task is not None:
            self.task.wake()

    def end(self, ended_by: EndedBy) -> bool:
        """End the operation; returns whether it did. A second time does nothing, it may be finishing its work."""
        task, self.task = self.task, None
        if task is not None:
            task.throw(Cancelled(ended_by))
        return task is not None

    def check_accepted(self) -> None:
        """Raise `Cancelled` if a stop, the end of the link lease or the latch came after this request was accepted."""
        if self.acceptance and (ended_by := self.acceptance.overtaken_by()):
            raise Cancelled(ended_by)

    def leave(self) -> None:
        """The exit: called directly before anything of this request is handed to the middleware; raises `Cancelled`."""
        try:
            self.check_accepted()
        except Cancelled as cancelled:
            if self.acceptance and self.task and cancelled.ended_by == "stop":
                self.acceptance.hold_back(self)
            raise
        self.has_left = True

    def has(self, name: str) -> bool:
        """Whether the argument is there and not null."""
        return self._header.get(name) is not None

    def text(self, name: str, default: str | None = None) -> str:
        """A string that is not empty; the default where it is absent, null or empty, an error if there is none."""
        if default is not None and not self._header.get(name):
            return default
        return self._required(name, "a string that is not empty", lambda value: value != "" and isinstance(value, str))

    def texts(self, name: str) -> list[str]:
        """A required list of strings."""
        return self._required(name, "a list of strings", lambda value: _is_list_of(str, value))

    def number(self, name: str, default: float | None = None) -> float:
        """A number that is not negative; the default where it is absent or null, an error if there is no default."""
        if default is not None and not self.has(name):
            return default
        return self._required(name, "a number that is not negative", lambda value: _is_number(value) and value >= 0)

    def flag(self, name: str) -> bool:
        """Whether the argument is there and true."""
        return self.has(name) and self._required(name, "true or false", lambda value: isinstance(value, bool))

    def rate(self) -> float:
        """The required `rate_hz`."""
        expected = f"a number from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}"
        return self._required(
            "rate_hz", expected, lambda value: _is_number(value) and MIN_RATE_HZ <= value <= MAX_RATE_HZ
        )

    def sizes(self, name: str) -> list[int]:
        """The required sizes of the parts that the body is made of."""
        size = len(self.body)
        expected = f"a list of sizes that add up to the body's {size} bytes"
        return self._required(name, expected, lambda value: _is_list_of(int, value) and sum(value) == size)

    def choice(self, name: str, choices: Sequence[str]) -> str:
        """A required string out of `choices`."""
        return self._required(name, "one of " + ", ".join(choices), lambda value: value in choices)

    def qos(self) -> Mapping[str, object]:
        """A required object of policies."""
        return self._required("qos", "an object", lambda value: isinstance(value, dict))

    def _required(self, name: str, expected: str, is_right: Callable[[Any], bool]) -> Any:
        """The argument, which `is_right` makes sure is of the type that the caller returns."""
        value = self._header.get(name)
        if not is_right(value):
            raise OperationError("bad_request", f"{self.op}: {name} is {value!r}, expected {expected}.")
        return value


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_list_of(kind: type, value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, kind) for item in cast("list[object]", value))
