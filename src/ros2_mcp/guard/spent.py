"""What was used of the bounds that a policy sets to how often something may be done, kept over restarts.

The bridge counts and refuses; it tells each use, and is told the recent ones at its start. Without that a bridge or a
server that is started again would have all of them again.
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
"""The slowest rate is one in 100 s; what is counted by the minute is over sooner."""
_MOST_TIMES = 1000
"""Of one name and bound: what may be done more often in a minute has little to do with a budget."""
_MOST_KEYS = 500
"""Names and bounds; the ones that were used longest ago are given up. 500 of 1000 times are 10 MB, and a policy that
allows them is none."""
_logger = logging.getLogger(__name__)

Key = tuple[str, str, str]
"""A name, its type, and the bound: `per_minute` or `rate_hz`."""


class Spent:
    """When each was used, in Unix time (s). `folder` is the robot's; without one nothing is kept.

    A clock that was set back makes what was used then count for a whole time again; one that was set ahead, for none.
    """

    def __init__(self, folder: StateFolder | None = None, now: Callable[[], float] = time.time) -> None:
        self._folder = folder
        self._now = now
        self._at: dict[Key, list[float]] = {}
        self._writing = threading.Lock()
        self._is_unwritten = False
        self.read()

    def read(self) -> None:
        """Take in what servers before this one have written, beside what this one has counted itself."""
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
        """It was used just now. Writes in a thread, at once."""
        key = name, type_name, bound
        times = self._at.pop(key, [])  # the last one is the last that was used
        self._at[key] = [*times[1 - _MOST_TIMES :], self._now()] if bound == "per_minute" else [self._now()]
        self._forget()
        if self._folder:
            self._is_unwritten = True
            threading.Thread(target=self._write, args=(self._folder,), daemon=True).start()

    def ages(self) -> Sequence[tuple[str, str, str, Sequence[float]]]:
        """Name, type, bound, and for how many seconds each use is past, the longest first: as a bridge is told it."""
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
    """The rules as a bridge is told them at its start, with what was used of them."""
    return json.dumps({**rules, "spent": spent.ages()}).encode()
