"""One parsed policy: its rules, and its other settings about the robot (`docs/reference/policy-file.md`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from ros2_mcp_common.policy.keep_out import KeepOut
from ros2_mcp_common.policy.rules import RuleSet

Mode = Literal["observe", "confirm", "autonomous"]
"""`observe`: only reading and stopping. `confirm`: every command needs an approval, unless its rule has the consent
`never`. `autonomous`: allowed commands are carried out, and only those whose rule has the consent `each` need an
approval."""


ODOMETRY = "nav_msgs/msg/Odometry"
"""The default message type of a robot's own velocity."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Feedback:
    """The topic of the robot's measured velocity, and the thresholds at which the watchdog stops the robot.

    `path` is the field of the message that has `linear` and `angular`. `still` are the speeds in m/s and rad/s below
    which the robot counts as stationary. The robot is stopped if it still moves `within_s` seconds after its zero, if
    its speed exceeds `over` times a limit on its velocity, or if no message arrived for `max_age_s` while it is driven.
    During a goal the robot's own controllers drive it: then `goals` (m/s, rad/s) replaces the limits; if empty, its
    speed is not checked.
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
    """The topic of the robot's pose, and the zone that the robot must not leave while it is driven ("": none).

    `brake_mps2` and `brake_radps2` are the robot's decelerations: the robot is stopped early enough to come to rest
    inside the zone, and before keep-out zones. `frame_id` is the frame of the zones: a pose in another frame counts as
    unknown. With a `base`, the topic has transforms, and the pose is the one from `frame_id` to `base`.
    """

    topic: str
    type: str = "geometry_msgs/msg/PoseWithCovarianceStamped"
    frame_id: str = "map"
    path: str = "pose.pose"
    max_age_s: float = 1.0
    zone: str = ""
    brake_mps2: float = 1.0
    base: str = ""
    brake_radps2: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Consent:
    """The way of approval: by an `operator` in the terminal (`ros2-mcp operate`), or by `elicitation`, also by the
    client's user.

    An approval is valid for `valid_s` seconds; a grant for at most `grants_s` seconds (0: no grants).
    """

    how: Literal["operator", "elicitation"] = "operator"
    valid_s: float = 60.0
    grants_s: float = 600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Auditing:
    """The size limit of the audit (None: the default), and whether a command that cannot be recorded is refused."""

    keep_bytes: int | None = None
    on_failure: Literal["refuse", "warn"] = "refuse"


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """One policy. `origin` is its path, or `profile nav`; it is shown to the operator and never to a client.

    `robot` is the name under which the robot's state is kept ("": a name made from domain and host). `state` is the
    parent of the robot's state folder ("": the default).
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
    keep_out: KeepOut | None = None
    consent: Consent = Consent()
    audit: Auditing = Auditing()

    @property
    def form(self) -> Mapping[str, Any]:
        """The canonical form, from which the digest is computed: the content without file name and line numbers."""
        form = {name: value for name, value in asdict(self).items() if name != "origin"}
        if form["keep_out"]:
            del form["keep_out"]["rule"]
        for entries in (form["rules"][key] for key in ("allow", "forbid", "limits")):
            for entry in entries:
                del entry["rule"]
        return form
