"""Small JSON files in a robot's state folder: read in full, written atomically."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any, cast

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadData, RobotError
from ros2_mcp_common.files import PLAIN, replace

_MOST_BYTES = 1_000_000
"""Largest file, several times the size of a thousand places. A larger file was not written by this server."""


def read_state(folder: StateFolder, file: str, what: str) -> Mapping[str, Any] | None:
    """Return the object in a file of the folder; None if there is no such file. `what` names its content in errors.

    Raises:
        BadData: if it cannot be read, or is no JSON object.
    """
    path = folder.path / file
    try:
        descriptor = os.open(path, os.O_RDONLY | PLAIN)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise BadData(f"The {what} cannot be read: {error}.") from error
    with os.fdopen(descriptor, "rb") as opened:
        text = opened.read(_MOST_BYTES + 1)
    try:
        value: object = json.loads(text)
    except ValueError as error:
        raise damaged(folder, file, what, error) from error
    if not isinstance(value, dict):
        raise damaged(folder, file, what, "no object")
    return cast("Mapping[str, Any]", value)


def damaged(folder: StateFolder, file: str, what: str, why: object) -> BadData:
    """Return the error for a file that does not contain what it should."""
    return BadData(f"The file of {what} {folder.path / file} is damaged: {why!r}.", "Repair the file, or move it away.")


def write_state(folder: StateFolder, file: str, value: Mapping[str, Any], what: str) -> None:
    """Write an object to a file of the folder; create the folder if necessary.

    Raises:
        RobotError: if it cannot be written.
    """
    made = folder.make()
    draft = made / f"{file}.{os.getpid()}"
    try:
        draft.write_text(json.dumps(value, indent=1), encoding="utf-8")
        replace(draft, made / file)
    except OSError as error:
        raise RobotError(f"The {what} cannot be written: {error}.") from error
