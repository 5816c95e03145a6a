"""The tree of all errors.

Every error has a message that says what was wrong, and a hint that says what would be right::

    RobotError
    ├── BadInput              the caller's arguments
    │   ├── BadName           not a valid ROS name
    │   ├── BadValue          a value that does not fit its definition (names the path)
    │   └── UnknownInterface  there is no known definition of that type
    ├── NotFound              the graph has nothing with that name
    ├── NoTransform           there is no transform between two frames
    ├── TypeConflict          several types, or another type than the requested one
    ├── TimedOut              a bounded wait ended
    ├── Refused               the policy of this server, or one of its limits, forbids it
    │   └── ApprovalNeeded    a person has to approve it first
    ├── Stopped               a stop came before the command was sent
    │   ├── Lapsed            the link lease lapsed before the command was sent
    │   └── Latched           the latch is set, which only an operator resets
    ├── Rehearsed             the command would be executed, but this is a rehearsal
    ├── AllFailed             every part of one call failed
    ├── BadData               bytes from the robot that do not fit their definition
    ├── Locked                a file that another program is writing to
    ├── SystemLimit           the operating system's limit of files, memory or disk is reached
    └── LinkError             between this server and the robot
        ├── RosNotFound       no ROS 2 installation to run the bridge with
        ├── Unreachable       the robot's machine could not be reached, or denies access
        ├── BridgeLost        the bridge died or hung, and is being restarted
        └── BridgeRefused     the bridge answered with an error
"""

from __future__ import annotations

LEASE = "the bridge, which had not heard from this server for longer than the link lease"
"""The reason for an end by a lapsed link lease; it completes "It was ended by …"."""


LATCH = "the latch of the robot, which only an operator resets"
"""The reason for an end by the latch; it completes "It was ended by …"."""


def latch_set_by(by: str) -> str:
    """Return `LATCH` with the operator and the reason of the latch, if known."""
    return f"{LATCH}; it was set by {by}" if by else LATCH


class RobotError(Exception):
    """Base of the errors that this package raises on purpose: `message` says what was wrong, `hint` what is right."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message} {self.hint}".rstrip()

    def again(self) -> RobotError:
        """Return a copy of the error, to raise it for another caller."""
        return type(self)(self.message, self.hint)


class BadInput(RobotError):
    """The caller's arguments are wrong."""


class BadName(BadInput):
    """A name that ROS does not allow."""


class BadValue(BadInput):
    """A value that does not fit its definition; `path` is its place, such as `pose.position.x` or `ranges[3]`."""

    def __init__(self, path: str, message: str, hint: str = "") -> None:
        super().__init__(f"{path}: {message}" if path else message, hint)
        self.path = path
        self._problem = message

    def below(self, field: str) -> BadValue:
        """Return the error with its path relative to `field`, for a caller that gave only the value of that field."""
        if self.path != field and not self.path.startswith((f"{field}.", f"{field}[")):
            return self
        return BadValue(self.path.removeprefix(field).removeprefix("."), self._problem, self.hint)


class UnknownInterface(BadInput):
    """There is no known definition of that type."""


class NotFound(RobotError):
    """The graph has nothing with that name."""


class NoTransform(RobotError):
    """There is no transform between two frames; `reason` says why in a word or two, such as `two trees`."""

    def __init__(self, reason: str, message: str, hint: str = "") -> None:
        super().__init__(message, hint)
        self.reason = reason

    def again(self) -> NoTransform:
        """Return a copy of the error, to raise it for another caller."""
        return NoTransform(self.reason, self.message, self.hint)


class TypeConflict(RobotError):
    """Several types under one name, or another type than the requested type."""


class TimedOut(RobotError):
    """A bounded wait ended before the expected event."""


class Refused(RobotError):
    """The policy of this server forbids the command, or one of its limits does."""


class ApprovalNeeded(Refused):
    """A person has to approve the command first: the same call again executes it once it is approved.

    `request_id` is the id under which the person sees the request.
    """

    def __init__(self, message: str, hint: str = "", *, request_id: str = "") -> None:
        super().__init__(message, hint)
        self.request_id = request_id


class Stopped(RobotError):
    """The command was accepted before a stop and is not sent after it; `may_have_left` if that is not certain.

    `reason` is what stopped it: it completes "It was ended by …".
    """

    def __init__(self, message: str, hint: str = "", *, reason: str = "ros2_stop", may_have_left: bool = False) -> None:
        super().__init__(message, hint)
        self.reason = reason
        self.may_have_left = may_have_left


class Lapsed(Stopped):
    """The link lease lapsed after the command was accepted."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message, hint, reason=LEASE)


class Latched(Stopped):
    """The latch of the robot is set, or was set after the command was accepted; only an operator resets it.

    `by` is the operator that set it and why, if known.
    """

    def __init__(self, message: str, hint: str = "", *, by: str = "") -> None:
        super().__init__(message, hint, reason=latch_set_by(by))


class Rehearsed(RobotError):
    """The command would be executed now, but this is a rehearsal."""


class AllFailed(RobotError):
    """Every part of one call failed, such as each of several topics."""


class BadData(RobotError):
    """Bytes from the robot do not fit their definition."""


class Locked(RobotError):
    """A file cannot be read at present, because another program is writing to it."""


class SystemLimit(RobotError):
    """A limit of the operating system is reached, such as open files; the request itself is not wrong."""


class LinkError(RobotError):
    """A failure between this server and the robot."""


class RosNotFound(LinkError):
    """There is no ROS 2 installation with which to run the bridge."""


class Unreachable(LinkError):
    """The robot's machine could not be reached, or denies access; `is_lasting` if only a person can change that."""

    def __init__(self, message: str, hint: str = "", *, is_lasting: bool = False) -> None:
        super().__init__(message, hint)
        self.is_lasting = is_lasting

    def again(self) -> Unreachable:
        """Return a copy of the error, to raise it for another caller."""
        return Unreachable(self.message, self.hint, is_lasting=self.is_lasting)


class BridgeLost(LinkError):
    """The bridge died or hung, and is being restarted."""


class BridgeRefused(LinkError):
    """The bridge answered with an error; `kind` is its machine-readable class."""

    def __init__(self, kind: str, message: str, hint: str = "") -> None:
        super().__init__(message, hint)
        self.kind = kind
