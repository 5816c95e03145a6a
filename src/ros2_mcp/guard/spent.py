"""The uses of the policy's rate limits, kept across restarts.

The bridge counts and refuses; it reports each use, and gets the recent uses at its start. Otherwise a restart of the
bridge or the server would reset the counts.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import RobotError
from ros2_mcp_common.files import PLAIN, replace

_FILE = "spent.json"
_KEPT_S = 120.0
"""The time for which a use is kept, in s: the slowest rate is one in 100 s, and `per_minute` needs less."""
_MOST_TIMES = 1000
"""The most times that are kept for one name and bound: more uses in a minute are no budget."""
_MOST_KEYS = 500
"""The most pairs of name and bound; the least recently used are dropped. 500 with 1000 times each take 10 MB, more than
a reasonable policy can need."""
_logger = logging.getLogger(__name__)

Key = tuple[str, str, str]
"""Name, type and bound (`per_minute` or `rate_hz`)."""


class Spent:
    """The times of the uses, in Unix time (s). `folder` is the robot's state folder; without it nothing is stored.

    If the clock is set back, earlier uses count for their full time again; if it is set forward, they no longer count.
    """

    def __init__(self, folder: StateFolder | None = None, now: Callable[[], float] = time.time) -> None:
        self._folder = folder
        self._now = now
        self._at: dict[Key, list[float]] = {}
        self._writing = threading.Lock()
        self._is_unwritten = False
        self.read()

    def read(self) -> None:
        """Merge the uses that earlier servers have stored with the uses counted here."""
        if self._folder is None:
            return
        try:
            uses = json.loads((self._folder.path / _FILE).read_text())
            now = self._now()
            found = {
                (str(name), str(kind), str(bound)): [min(float(at), now) for at in times]
                for name, kind, bound, times in cast("Sequence[tuple[str, str, str, Sequence[float]]]", uses)
            }
        except FileNotFoundError:
            return
        except (OSError, ValueError, TypeError) as error:
            _logger.warning("what was used of the policy's budgets cannot be read, and counts as nothing: %s", error)
            return
        for key, times in found.items():
            self._at[key] = sorted({*times, *self._at.get(key, ())})[-_MOST_TIMES:]

    def add(self, name: str, type_name: str, bound: str) -> None:
        """Record a use now, and store it at once in a thread."""
        key = name, type_name, bound
        times = self._at.pop(key, [])  # reinserted at the end: the order is that of the last use
        self._at[key] = [*times[1 - _MOST_TIMES :], self._now()] if bound == "per_minute" else [self._now()]
        self._forget()
        if self._folder:
            self._is_unwritten = True
            threading.Thread(target=self._write, args=(self._folder,), daemon=True).start()

    def ages(self) -> Sequence[tuple[str, str, str, Sequence[float]]]:
        """Return name, type, bound and the ages of the uses in s, oldest first, in the form that a bridge gets."""
        self._forget()
        now = self._now()
        return [(*key, [max(0.0, round(now - at, 3)) for at in times]) for key, times in self._at.items()]

    def _forget(self) -> None:
        oldest = self._now() - _KEPT_S
        kept = {key: recent for key, times in self._at.items() if (recent := [at for at in times if at > oldest])}
        self._at = dict(list(kept.items())[-_MOST_KEYS:])

    def _write(self, folder: StateFolder) -> None:
        with self._writing:
            if not self._is_unwritten:
                return
            self._is_unwritten = False
            uses = [[*key, times] for key, times in list(self._at.items())]
            try:
                path = folder.make() / _FILE
                new = path.with_suffix(f".{os.getpid()}.new")
                with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | PLAIN, 0o600), "w") as file:
                    json.dump(uses, file)
                replace(new, path)
            except (OSError, RobotError) as error:
                _logger.warning("what was used of the policy's budgets is not kept: %s", error)


def told(rules: Mapping[str, Any], spent: Spent) -> bytes:
    """Return the rules and their uses as the JSON that a bridge gets at its start."""
    return json.dumps({**rules, "spent": spent.ages()}).encode()
