# pyright: basic
"""One request of the server with its arguments checked, and the error that answers a request that failed."""

from __future__ import annotations

from .limits import MAX_RATE_HZ


class OperationError(Exception):
    """Answers a request with an error; `kind` is one of the kinds in docs/reference/stream.md."""

    def __init__(self, kind, message, hint=""):
        super().__init__(message)
        self.kind = kind
        self.message = message
        self.hint = hint

    def as_json(self):
        """The `error` part of the answer."""
        return {"kind": self.kind, "message": self.message, "hint": self.hint}


class Cancelled(OperationError):
    """Thrown into an operation when the server cancels its request."""

    def __init__(self):
        super().__init__("cancelled", "The request was cancelled.")


class Request:
    """A request: `id`, `op`, `body`, and arguments that raise `OperationError` of kind `bad_request` when wrong.

    `interface` is the Python class of the argument `type`, where there is one; `task` is what works on the request, as
    long as it can be cancelled.
    """

    interface = None
    task = None

    def __init__(self, header, body):
        self.id = header.get("id")
        self.op = header.get("op")
        self.body = body
        self._header = header

    def wake(self):
        """Let the operation look again at once at what it waits for."""
        if self.task is not None:
            self.task.wake()

    def cancel(self):
        """End the operation; returns whether it did. A second time does nothing, it may be finishing its work."""
        task, self.task = self.task, None
        if task is not None:
            task.throw(Cancelled())
        return task is not None

    def text(self, name):
        """A required string that is not empty."""
        return self._required(name, "a string that is not empty", lambda value: isinstance(value, str) and value)

    def texts(self, name):
        """A required list of strings."""
        return self._required(name, "a list of strings", lambda value: _is_list_of(str, value))

    def number(self, name, default=None):
        """A number that is not negative; the default where it is absent or null, an error if there is no default."""
        if default is not None and not self.has(name):
            return default
        return self._required(name, "a number that is not negative", _is_number)

    def rate(self):
        """The required `rate_hz`."""
        expected = f"a number above 0, up to {MAX_RATE_HZ:g}"
        return self._required("rate_hz", expected, lambda value: _is_number(value) and 0 < value <= MAX_RATE_HZ)

    def sizes(self, name):
        """The required sizes of the parts that the body is made of."""
        size = len(self.body)
        expected = f"a list of sizes that add up to the body's {size} bytes"
        return self._required(name, expected, lambda value: _is_list_of(int, value) and sum(value) == size)

    def choice(self, name, choices):
        """A required string out of `choices`."""
        return self._required(name, "one of " + ", ".join(choices), lambda value: value in choices)

    def has(self, name):
        """Whether the argument is there and not null."""
        return self._header.get(name) is not None

    def qos(self):
        """A required object of policies."""
        return self._required("qos", "an object", lambda value: isinstance(value, dict))

    def _required(self, name, expected, fits):
        value = self._header.get(name)
        if not fits(value):
            raise OperationError("bad_request", f"{self.op}: {name} is {value!r}, expected {expected}.")
        return value


def _is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value >= 0


def _is_list_of(kind, value):
    return isinstance(value, list) and all(isinstance(each, kind) for each in value)
