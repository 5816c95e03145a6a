"""What this server has sent without knowing how it is stopped: service calls, and messages that are no velocities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Literal

from ros2_mcp.model.errors import RobotError
from ros2_mcp.robot.graph import was_refused

Kind = Literal["service", "topic"]
MOVES_NOTHING = frozenset(
    {
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "nav2_msgs/srv/ClearCostmapAroundRobot",
        "nav2_msgs/srv/ClearCostmapExceptRegion",
        "nav2_msgs/srv/ClearEntireCostmap",
        "nav2_msgs/srv/LoadMap",
        "nav2_msgs/srv/ManageLifecycleNodes",
        "nav2_msgs/srv/SaveMap",
        "nav2_msgs/srv/SetInitialPose",
        "nav_msgs/srv/LoadMap",
        "nav_msgs/srv/SetMap",
        "rcl_interfaces/srv/SetLoggerLevels",
        "robot_localization/srv/SetPose",
    }
)
"""Types that say where the robot is, clear or load maps, or start and pause nodes without a task: they are
configuration, as parameters are, and set nothing in motion. PoseWithCovarianceStamped is an estimate; a goal has no
covariance.
"""
_MOST_KEPT = 1000
"""Of each kind: more names than any robot has. Beyond, the oldest is forgotten, never that there were some."""


class NoKnownStop:
    """The names of services that were called, and of topics that were published on, for as long as the server lives.

    Whether what they set in motion continues cannot be seen from here: `ros2_stop` names them. What was sent before
    the robot was seen to stand is *settled*: it no longer keeps a stop from being confirmed.
    """

    def __init__(self) -> None:
        self._sent: dict[Kind, dict[str, None]] = {"service": {}, "topic": {}}
        self._settled: set[tuple[Kind, str]] = set()
        self._under_way: Counter[tuple[Kind, str]] = Counter()

    def names(self, kind: Kind) -> Sequence[str]:
        """Each with its type, such as `/arm/home (std_srvs/srv/Trigger)`; the last one sent comes first."""
        under_way = [name for (of_kind, name), count in self._under_way.items() if of_kind == kind and count > 0]
        return list(dict.fromkeys([*under_way, *reversed(self._sent[kind])]))

    def unsettled(self) -> Sequence[tuple[Kind, str]]:
        """Kinds and names of what was sent since the robot was last seen to stand, or has not been answered."""
        return [
            (kind, name)
            for kind in self._sent
            for name in self.names(kind)
            if (kind, name) not in self._settled or self._under_way[kind, name] > 0
        ]

    def settle(self, unsettled: Sequence[tuple[Kind, str]]) -> None:
        """Notes that the robot was seen to stand after these were sent; those under way stay unsettled."""
        self._settled.update(one for one in unsettled if not self._under_way[one])

    def note(self, kind: Kind, name: str) -> None:
        """Notes that it was sent."""
        self._settled.discard((kind, name))
        sent = self._sent[kind]
        sent.pop(name, None)
        sent[name] = None
        if len(sent) > _MOST_KEPT:
            oldest = next(iter(sent))
            del sent[oldest]
            self._settled.discard((kind, oldest))

    @contextmanager
    def sending(self, kind: Kind, name: str, type_name: str) -> Generator[None, None, None]:
        """Around a request: it is noted, unless its type moves nothing, or the bridge says that nothing was sent."""
        if type_name in MOVES_NOTHING:
            yield
            return
        name = f"{name} ({type_name})"
        self._under_way[kind, name] += 1
        try:
            yield
        except RobotError as error:
            if not was_refused(error):
                self.note(kind, name)
            raise
        except BaseException:
            self.note(kind, name)
            raise
        else:
            self.note(kind, name)
        finally:
            self._under_way[kind, name] -= 1
            if not self._under_way[kind, name]:
                del self._under_way[kind, name]
