"""The one tree of errors.

Every error carries a message that says what was wrong and a hint that says what would be right::

    RobotError
    ├── BadInput              the caller's arguments
    │   ├── BadName           not a valid ROS name
    │   ├── BadValue          a value that does not fit its definition (names the path)
    │   └── UnknownInterface  no definition of that type is known
    ├── NotFound              nothing of that name is in the graph
    ├── NoTransform           where one frame is in another is not known
    ├── TypeConflict          several types, or another type than the one asked for
    ├── TimedOut              a bounded wait ended
    ├── Refused               the policy of this server forbids it, or one of its limits
    │   └── ApprovalNeeded    a person has to approve it first
    ├── Stopped               a stop came first
    │   ├── Lapsed            or the end of the link lease did
    │   └── Latched           or the latch is set, which only an operator resets
    ├── Rehearsed             it would be done, and is not: this is a rehearsal
    ├── AllFailed             everything that one call asked for failed
    ├── BadData               bytes from the robot that do not fit their definition
    ├── Locked                a file that another program is writing to
    ├── SystemLimit           the operating system gives this server no more files, memory or disk
    └── LinkError             between this server and the robot
        ├── RosNotFound       no ROS 2 installation to run the bridge with
        ├── Unreachable       the machine of the robot was not reached, or lets nobody in
        ├── BridgeLost        the bridge died or hung; it is being started again
        └── BridgeRefused     the bridge answered with an error
"""

from __future__ import annotations

LEASE = "the bridge, which had not heard from this server for longer than the link lease"
"""What has ended something where a link lease lapsed; it completes "It was ended by …"."""


LATCH = "the latch of the robot, which only an operator resets"
"""The same, where the latch was set."""


def latch_set_by(by: str) -> str:
    """The same, with who has set it and why, where that is known."""
    return f"{LATCH}; it was set by {by}" if by else LATCH


class RobotError(Exception):
    """Base of everything this package raises on purpose: `message` says what was wrong, `hint` what would be right."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message} {self.hint}".rstrip()

    def again(self) -> RobotError:
        """The same error for one more who is to be told."""
        return type(self)(self.message, self.hint)


class BadInput(RobotError):
    """The caller's arguments are wrong."""


class BadName(BadInput):
    """A name that ROS does not allow."""


class BadValue(BadInput):
    """A value that does not fit its definition; `path` says where, such as `pose.position.x` or `ranges[3]`."""

    def __init__(self, path: str, message: str, hint: str = "") -> None:
        super().__init__(f"{path}: {message}" if path else message, hint)
        self.path = path
        self._problem = message

    def below(self, field: str) -> BadValue:
        """The same error for who gave the value of that field alone: its path begins there."""
        if self.path != field and not self.path.startswith((f"{field}.", f"{field}[")):
            return self
        return BadValue(self.path.removeprefix(field).removeprefix("."), self._problem, self.hint)


class UnknownInterface(BadInput):
    """No definition of that type is known here."""


class NotFound(RobotError):
    """Nothing of that name is in the graph."""


class NoTransform(RobotError):
    """Where one frame is in another is not known; `reason` says why in a word or two, such as `two trees`."""

    def __init__(self, reason: str, message: str, hint: str = "") -> None:
        super().__init__(message, hint)
        self.reason = reason

    def again(self) -> NoTransform:
        """The same error for one more who is to be told."""
        return NoTransform(self.reason, self.message, self.hint)


class TypeConflict(RobotError):
    """Several types under one name, or another type than the one asked for."""


class TimedOut(RobotError):
    """A bounded wait ended before what it waited for happened."""


class Refused(RobotError):
    """The policy of this server forbids it, or one of its limits."""


class ApprovalNeeded(Refused):
    """A person has to approve it first: the same call again is carried out once it is approved.

    `request_id` is what the person sees it under.
    """

    def __init__(self, message: str, hint: str = "", *, request_id: str = "") -> None:
        super().__init__(message, hint)
        self.request_id = request_id


class Stopped(RobotError):
    """It was accepted before a stop came, and is not sent after it; `may_have_left` where that is not known.

    `reason` is what stopped it: it completes "It was ended by …".
    """

    def __init__(self, message: str, hint: str = "", *, reason: str = "ros2_stop", may_have_left: bool = False) -> None:
        super().__init__(message, hint)
        self.reason = reason
        self.may_have_left = may_have_left


class Lapsed(Stopped):
    """The link lease lapsed after it was accepted."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message, hint, reason=LEASE)


class Latched(Stopped):
    """The latch of the robot is set, or was since it was accepted; only an operator resets it. `by` says who has set it
    and why, if that is known.
    """

    def __init__(self, message: str, hint: str = "", *, by: str = "") -> None:
        super().__init__(message, hint, reason=latch_set_by(by))


class Rehearsed(RobotError):
    """It would be done now, and is not: this is a rehearsal."""


class AllFailed(RobotError):
    """Everything that one call asked for failed, such as each of several topics."""


class BadData(RobotError):
    """Bytes from the robot that do not fit their definition."""


class Locked(RobotError):
    """A file that cannot be read just now, because another program is writing to it."""


class SystemLimit(RobotError):
    """The operating system gives this server no more of something, such as open files: nobody's request is wrong."""


class LinkError(RobotError):
    """Something between this server and the robot."""


class RosNotFound(LinkError):
    """There is no ROS 2 installation to run the bridge with."""


class Unreachable(LinkError):
    """The machine of the robot was not reached, or lets nobody in; `is_lasting` where only a person changes that."""

    def __init__(self, message: str, hint: str = "", *, is_lasting: bool = False) -> None:
        super().__init__(message, hint)
        self.is_lasting = is_lasting

    def again(self) -> Unreachable:
        """The same error for one more who is to be told."""
        return Unreachable(self.message, self.hint, is_lasting=self.is_lasting)


class BridgeLost(LinkError):
    """The bridge died or hung; it is being started again."""


class BridgeRefused(LinkError):
    """The bridge answered with an error; `kind` is its machine-readable class."""

    def __init__(self, kind: str, message: str, hint: str = "") -> None:
        super().__init__(message, hint)
        self.kind = kind
