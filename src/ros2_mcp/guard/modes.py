"""The mode in force: set by the policy, changed by an operator, kept across restarts."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping

from ros2_mcp.guard.document import Mode
from ros2_mcp.guard.policy import MODES, strictest
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp_common.files import PLAIN, replace

_FILE = "mode.json"
_BY_NAME: Mapping[str, Mode] = {mode: mode for mode in MODES}


class Modes:
    """The mode of one robot. `most` is the policy's mode: an operator may set a stricter one and return to `most`.

    The operator's choice is stored with the policy's hash: under another policy it no longer applies.
    """

    def __init__(self, folder: StateFolder, *, most: Mode = "autonomous", policy: str = "") -> None:
        self._folder = folder
        self._policy = policy
        self.most: Mode = most
        self.now: Mode = most
        if policy and (kept := self._read()):
            self.now = strictest(kept, most)

    def set(self, mode: str) -> Mode:
        """Change the mode; return the former mode.

        Raises:
            BadInput: if there is no such mode, the policy does not allow it, or it cannot be stored.
        """
        if not self._policy:
            raise BadInput("No policy is in force, and without one there are no modes.", "Start the server with one.")
        chosen = _BY_NAME.get(mode)
        if chosen is None:
            raise BadInput(f"There is no mode {mode!r}.", f"Choose from {', '.join(MODES)}.")
        if strictest(chosen, self.most) != chosen:
            raise BadInput(f"The policy allows {self.most} at most.")
        before, self.now = self.now, chosen
        try:
            self._write()
        except (OSError, RobotError) as error:
            raise BadInput(f"The mode is {mode} now, but a restart will forget it: {error}") from error
        return before

    def _write(self) -> None:
        path = self._folder.make() / _FILE
        new = path.with_suffix(".new")
        fd = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | PLAIN, 0o600)
        with os.fdopen(fd, "w") as file:
            json.dump({"mode": self.now, "policy": self._policy}, file)
        replace(new, path)

    def _read(self) -> Mode | None:
        try:
            kept = json.loads((self._folder.path / _FILE).read_text())
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            return "observe"  # the operator's choice is unknown: assume the strictest mode
        if not isinstance(kept, dict) or kept.get("policy") != self._policy:  # pyright: ignore[reportUnknownMemberType]
            return None
        return kept["mode"] if kept.get("mode") in MODES else "observe"  # pyright: ignore
