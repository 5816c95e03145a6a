"""A request of the server with checked arguments, and the errors that answer a failed request."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, Union, cast

from ros2_mcp_common.wire.limits import MAX_RATE_HZ, MIN_RATE_HZ

if TYPE_CHECKING:
    from ros2_mcp_bridge.epoch import Acceptance
    from ros2_mcp_common.wire.protocol import EndedBy, ErrorKind, Failure

T = TypeVar("T")

Steps = Generator[float, None, T]
"""An operation that waits, as a generator: it yields the seconds after which it is to be
resumed, and returns its result.
"""

Answer = Union[Mapping[str, object], "tuple[Mapping[str, object], bytes]", None]
"""The `ok` part of an answer, with a body if any; None if the answer is sent in another way."""


class OperationError(Exception):
    """An error that answers a request."""

    def __init__(self, kind: ErrorKind, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.kind: ErrorKind = kind
        self.message = message
        self.hint = hint

    def as_json(self) -> Failure:
        """Return the `error` part of the answer."""
        return {"kind": self.kind, "message": self.message, "hint": self.hint}


_WHY_ENDED: Mapping[EndedBy, tuple[ErrorKind, str]] = {
    "cancel": ("cancelled", "The request was cancelled"),
    "stop": ("stopped", "A stop came after this was accepted"),
    "lease": ("lapsed", "The server was silent for longer than its link lease"),
    "latch": ("latched", "The latch of this robot is set, or was since this was accepted; only an operator resets it"),
    "stopper": ("stopped", "The stopper died, and what moved was stopped"),
    "keep_out": ("refused", "The robot was about to enter a keep-out zone of its policy"),
}


class Cancelled(OperationError):
    """Raised inside an operation that is ended early: says what ended it, and what it had sent by then."""

    def __init__(self, ended_by: EndedBy = "cancel", sent: str = "nothing was sent") -> None:
        kind, why = _WHY_ENDED[ended_by]
        super().__init__(kind, f"{why}: {sent}.")
        self.ended_by: EndedBy = ended_by


class Work(Protocol):
    """The execution of a request: a `Task` of the loop."""

    def wake(self) -> None:
        """Resume the operation at once."""
        ...

    def throw(self, error: Exception) -> None:
        """Raise an exception in the operation, where it waits."""
        ...


class Request:
    """A request: `id`, `op`, `body`, and arguments. Reading a wrong argument raises
    `OperationError` of kind `bad_request`.

    `interface` is the Python class of the argument `type`, if there is one; `task` executes the request, as long as it
    can be cancelled. A request that acts has an `acceptance`; `has_left` is True as soon as some of it was sent.
    `ended` is the number of other requests that it has ended.
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
        """Resume the operation at once, so that it checks again what it waits for."""
        if self.task is not None:
            self.task.wake()

    def end(self, ended_by: EndedBy) -> bool:
        """End the operation; return whether it could be ended.

        A second call has no effect, because it may be finishing its work.
        """
        task, self.task = self.task, None
        if task is not None:
            task.throw(Cancelled(ended_by))
        return task is not None

    def check_accepted(self) -> None:
        """Raise `Cancelled` if a stop, the end of the link lease or the latch came after this request was accepted."""
        if self.acceptance and (ended_by := self.acceptance.overtaken_by()):
            raise Cancelled(ended_by)

    def leave(self) -> None:
        """Check that the request may still act; called directly before anything of it is handed to the middleware.

        Raises:
            Cancelled: if a stop, the end of the link lease or the latch came after it was accepted.
        """
        try:
            self.check_accepted()
        except Cancelled as cancelled:
            if self.acceptance and self.task and cancelled.ended_by == "stop":
                self.acceptance.hold_back(self)
            raise
        self.has_left = True

    def has(self, name: str) -> bool:
        """Return whether the argument is there and not null."""
        return self._header.get(name) is not None

    def text(self, name: str, default: str | None = None) -> str:
        """Return a string that is not empty.

        If it is absent, null or empty, return the default; without a default, raise.
        """
        if default is not None and not self._header.get(name):
            return default
        return self._required(name, "a string that is not empty", lambda value: value != "" and isinstance(value, str))

    def texts(self, name: str) -> list[str]:
        """Return a required list of strings."""
        return self._required(name, "a list of strings", lambda value: _is_list_of(str, value))

    def number(self, name: str, default: float | None = None) -> float:
        """Return a number of at least 0. If it is absent or null, return the default; without a default, raise."""
        if default is not None and not self.has(name):
            return default
        return self._required(name, "a number that is not negative", lambda value: _is_number(value) and value >= 0)

    def flag(self, name: str) -> bool:
        """Return whether the argument is there and true."""
        return self.has(name) and self._required(name, "true or false", lambda value: isinstance(value, bool))

    def rate(self) -> float:
        """Return the required `rate_hz`."""
        expected = f"a number from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}"
        return self._required(
            "rate_hz", expected, lambda value: _is_number(value) and MIN_RATE_HZ <= value <= MAX_RATE_HZ
        )

    def sizes(self, name: str) -> list[int]:
        """Return the required sizes of the parts of the body, in bytes."""
        size = len(self.body)
        expected = f"a list of sizes that add up to the body's {size} bytes"
        return self._required(name, expected, lambda value: _is_list_of(int, value) and sum(value) == size)

    def choice(self, name: str, choices: Sequence[str]) -> str:
        """Return a required string, one of `choices`."""
        return self._required(name, "one of " + ", ".join(choices), lambda value: value in choices)

    def qos(self) -> Mapping[str, object]:
        """Return the required object of QoS policies."""
        return self._required("qos", "an object", lambda value: isinstance(value, dict))

    def _required(self, name: str, expected: str, is_right: Callable[[Any], bool]) -> Any:
        """Return the argument, of which `is_right` has checked that it has the type that the caller returns."""
        value = self._header.get(name)
        if not is_right(value):
            raise OperationError("bad_request", f"{self.op}: {name} is {value!r}, expected {expected}.")
        return value


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_list_of(kind: type, value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, kind) for item in cast("list[object]", value))
