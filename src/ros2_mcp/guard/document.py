"""One policy as it was read: its rules, and what else it says of the robot (`docs/reference/policy-file.md`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from ros2_mcp_common.policy.rules import RuleSet

Mode = Literal["observe", "confirm", "autonomous"]
"""`observe`: only reading and stopping. `confirm`: what acts waits for a person, but where a rule says `never`.
`autonomous`: what the rules allow is done, and only what a rule says `each` of waits."""


ODOMETRY = "nav_msgs/msg/Odometry"
"""The type in which a robot tells its own speed, where a policy names no other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Feedback:
    """Where the robot's own speed is read, and what of it stops the robot.

    `path` is the field of the message with `linear` and `angular`, `still` the lengths in m/s and rad/s below which the
    robot counts as standing. It is stopped when it still moves `within_s` after its zero, when it is `over` times
    faster than a limit on its velocity, and when nothing was heard for `max_age_s` while it is driven. While a goal
    runs it drives itself, and `goals` (m/s, rad/s) holds instead of the limits; empty: its speed is not judged then.
    """

    topic: str
    type: str = ODOMETRY
    path: str = "twist.twist"
    still: Mapping[str, float] = field(default_factory=lambda: {"linear": 0.03, "angular": 0.05})
    within_s: float = 1.0
    over: float = 1.2
    max_age_s: float = 0.5
    goals: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Where the robot's place is read, and the zone that it may not leave while it is driven; empty: none.

    `brake_mps2` is how hard it brakes: it is stopped so early that it stands before the edge. `frame_id` is that of the
    zone: a place in another frame is not known.
    """

    topic: str
    type: str = "geometry_msgs/msg/PoseWithCovarianceStamped"
    frame_id: str = "map"
    path: str = "pose.pose"
    max_age_s: float = 1.0
    zone: str = ""
    brake_mps2: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Consent:
    """Who approves: `operator` in the terminal (`ros2-mcp operate`), or also the client's user by `elicitation`.

    An approval holds for `valid_s`; a grant at most for `grants_s` (0: there are none).
    """

    how: Literal["operator", "elicitation"] = "operator"
    valid_s: float = 60.0
    grants_s: float = 600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Auditing:
    """How much of the audit is kept (None: as usual), and what happens to a command that cannot be written down."""

    keep_bytes: int | None = None
    on_failure: Literal["refuse", "warn"] = "refuse"


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """One policy. `origin` is where it came from, for the operator and never for a client: a path, or `profile nav`.

    `robot` is the robot's name, for which state is kept; empty: that of the domain and host. `state` is the folder for
    it; empty: the usual one.
    """

    name: str
    origin: str
    rules: RuleSet
    about: str = ""
    robot: str = ""
    mode: Mode = "autonomous"
    state: str = ""
    feedback: Feedback | None = None
    pose: Pose | None = None
    consent: Consent = Consent()
    audit: Auditing = Auditing()

    @property
    def form(self) -> Mapping[str, Any]:
        """The canonical form, of which the digest is made: what it says, and not where or in which lines."""
        form = {name: value for name, value in asdict(self).items() if name != "origin"}
        for entries in (form["rules"][key] for key in ("allow", "forbid", "limits")):
            for entry in entries:
                del entry["rule"]
        return form
