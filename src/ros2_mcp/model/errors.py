"""The one tree of errors.

Every error carries a message that says what was wrong and a hint that says what would be right::

    RobotError
    ├── BadInput              the caller's arguments
    │   ├── BadName           not a valid ROS name
    │   ├── BadValue          a value that does not fit its definition (names the path)
    │   └── UnknownInterface  no definition of that type is known
    ├── NotFound              nothing of that name is in the graph
    ├── TypeConflict          several types, or another type than the one asked for
    ├── TimedOut              a bounded wait ended
    ├── Refused               the policy of this server forbids it, or one of its limits
    ├── Stopped               a stop came first
    ├── AllFailed             everything that one call asked for failed
    ├── BadData               bytes from the robot that do not fit their definition
    └── LinkError             between this server and the robot
        ├── RosNotFound       no ROS 2 installation to run the bridge with
        ├── BridgeLost        the bridge died or hung; it is being started again
        └── BridgeRefused     the bridge answered with an error
"""

from __future__ import annotations


class RobotError(Exception):
    """Base of everything this package raises on purpose: `message` says what was wrong, `hint` what would be right."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message} {self.hint}".rstrip()


class BadInput(RobotError):
    """The caller's arguments are wrong."""


class BadName(BadInput):
    """A name that ROS does not allow."""


class BadValue(BadInput):
    """A value that does not fit its definition; `path` says where, such as `pose.position.x` or `ranges[3]`."""

    def __init__(self, path: str, message: str, hint: str = "") -> None:
        super().__init__(f"{path}: {message}" if path else message, hint)
        self.path = path


class UnknownInterface(BadInput):
    """No definition of that type is known here."""


class NotFound(RobotError):
    """Nothing of that name is in the graph."""


class TypeConflict(RobotError):
    """Several types under one name, or another type than the one asked for."""


class TimedOut(RobotError):
    """A bounded wait ended before what it waited for happened."""


class Refused(RobotError):
    """The policy of this server forbids it, or one of its limits."""


class Stopped(RobotError):
    """It was accepted before a stop came, and is not sent after it; `may_have_left` where that is not known."""

    def __init__(self, message: str, hint: str = "", *, may_have_left: bool = False) -> None:
        super().__init__(message, hint)
        self.may_have_left = may_have_left


class AllFailed(RobotError):
    """Everything that one call asked for failed, such as each of several topics."""


class BadData(RobotError):
    """Bytes from the robot that do not fit their definition."""


class LinkError(RobotError):
    """Something between this server and the robot."""


class RosNotFound(LinkError):
    """There is no ROS 2 installation to run the bridge with."""


class BridgeLost(LinkError):
    """The bridge died or hung; it is being started again."""


class BridgeRefused(LinkError):
    """The bridge answered with an error; `kind` is its machine-readable class."""

    def __init__(self, kind: str, message: str, hint: str = "") -> None:
        super().__init__(message, hint)
        self.kind = kind
