"""What this server has sent without knowing how it is stopped: service calls, and messages that are no velocities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Literal

from ros2_mcp.model.errors import RobotError
from ros2_mcp.robot.graph import was_refused

Kind = Literal["service", "topic"]
_MOST_KEPT = 1000
"""Of each kind: more names than any robot has. Beyond, the oldest is forgotten, never that there were some."""


class NoKnownStop:
    """The names of services that were called, and of topics that were published on, for as long as the server lives.

    Whether what they set in motion goes on cannot be seen from here: `ros2_stop` names them.
    """

    def __init__(self) -> None:
        self._sent: dict[Kind, dict[str, None]] = {"service": {}, "topic": {}}
        self._under_way: Counter[tuple[Kind, str]] = Counter()

    def names(self, kind: Kind) -> Sequence[str]:
        """Each with its type, such as `/arm/home (std_srvs/srv/Trigger)`; the last one sent comes first."""
        under_way = [name for (of_kind, name), count in self._under_way.items() if of_kind == kind and count > 0]
        return list(dict.fromkeys([*under_way, *reversed(self._sent[kind])]))

    def note(self, kind: Kind, name: str) -> None:
        """Notes that it was sent."""
        sent = self._sent[kind]
        sent.pop(name, None)
        sent[name] = None
        if len(sent) > _MOST_KEPT:
            del sent[next(iter(sent))]

    @contextmanager
    def sending(self, kind: Kind, name: str) -> Generator[None, None, None]:
        """Around a request: it is noted, unless the bridge says that nothing was sent."""
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
