# pyright: basic
"""One request of the server with its arguments checked, and the error that answers a request that failed."""

from __future__ import annotations


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

    `interface` is the Python class of the argument `type`, where there is one; `task` is what works on the request.
    """

    interface = None
    task = None

    def __init__(self, header, body):
        self.id = header.get("id")
        self.op = header.get("op")
        self.body = body
        self._header = header
        self._is_cancelled = False

    def wake(self):
        """Let the operation look again at once at what it waits for."""
        if self.task is not None:
            self.task.wake()

    def cancel(self):
        """End the operation; a second time does nothing, it may be finishing its work."""
        if self.task is not None and not self._is_cancelled:
            self._is_cancelled = True
            self.task.throw(Cancelled())

    def text(self, name):
        """A required string that is not empty."""
        value = self._header.get(name)
        if not isinstance(value, str) or not value:
            raise self._bad(name, "a string that is not empty")
        return value

    def texts(self, name):
        """A required list of strings."""
        value = self._header.get(name)
        if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
            raise self._bad(name, "a list of strings")
        return value

    def number(self, name, default=None):
        """A number that is not negative; the default where it is absent or null, an error if there is no default."""
        value = self._header.get(name)
        if value is None and default is not None:
            return default
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value < 0:
            raise self._bad(name, "a number that is not negative")
        return value

    def sizes(self, name):
        """The required sizes of the parts that the body is made of."""
        value = self._header.get(name)
        if not isinstance(value, list) or not all(isinstance(size, int) and size >= 0 for size in value):
            raise self._bad(name, "a list of sizes")
        if sum(value) != len(self.body):
            raise self._bad(name, f"sizes that add up to the body's {len(self.body)} bytes")
        return value

    def choice(self, name, choices):
        """A required string out of `choices`."""
        value = self._header.get(name)
        if value not in choices:
            raise self._bad(name, "one of " + ", ".join(choices))
        return value

    def flag(self, name, default):
        """A boolean."""
        return bool(self._header.get(name, default))

    def has(self, name):
        """Whether the argument is there and not null."""
        return self._header.get(name) is not None

    def qos(self, name="qos"):
        """A required object of policies."""
        value = self._header.get(name)
        if not isinstance(value, dict):
            raise self._bad(name, "an object")
        return value

    def _bad(self, name, expected):
        given = self._header.get(name)
        return OperationError("bad_request", f"{self.op}: {name} is {given!r}, expected {expected}.")
