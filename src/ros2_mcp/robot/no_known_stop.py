"""The service calls and messages that this server has sent without knowing a way to stop their effect."""

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
        "slam_toolbox/srv/DeserializePoseGraph",
        "slam_toolbox/srv/SaveMap",
        "slam_toolbox/srv/SerializePoseGraph",
    }
)
"""Types that set the robot's pose estimate, clear or load maps, or start and pause nodes without a task. They are
configuration, as parameters are, and set nothing in motion. PoseWithCovarianceStamped is an estimate; a goal has no
covariance."""
_MOST_KEPT = 1000
"""The most names of each kind: more than any robot has. Beyond, the oldest name is forgotten."""


class NoKnownStop:
    """The names of called services and of topics that were published on, for the life of the server.

    Whether their effects continue cannot be observed here, so `ros2_stop` names them. Entries from before the robot was
    observed still are *settled*: they no longer keep a stop from being confirmed.
    """

    def __init__(self) -> None:
        self._sent: dict[Kind, dict[str, None]] = {"service": {}, "topic": {}}
        self._settled: set[tuple[Kind, str]] = set()
        self._under_way: Counter[tuple[Kind, str]] = Counter()

    def names(self, kind: Kind) -> Sequence[str]:
        """Return the names with their types, such as `/arm/home (std_srvs/srv/Trigger)`, most recent first."""
        under_way = [name for (of_kind, name), count in self._under_way.items() if of_kind == kind and count > 0]
        return list(dict.fromkeys([*under_way, *reversed(self._sent[kind])]))

    def unsettled(self) -> Sequence[tuple[Kind, str]]:
        """Return kind and name of each entry sent since the robot was last observed still, or not answered yet."""
        return [
            (kind, name)
            for kind in self._sent
            for name in self.names(kind)
            if (kind, name) not in self._settled or self._under_way[kind, name] > 0
        ]

    def settle(self, unsettled: Sequence[tuple[Kind, str]]) -> None:
        """Record that the robot was observed still after these entries were sent. Entries in progress stay open."""
        self._settled.update(one for one in unsettled if not self._under_way[one])

    def note(self, kind: Kind, name: str) -> None:
        """Record that a request or message was sent."""
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
        """A context manager around a request: it is recorded, unless its type moves nothing or the bridge sent
        nothing.
        """
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
