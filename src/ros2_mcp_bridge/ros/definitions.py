"""The texts of interface definitions, read from the ament index. Needs no rclpy."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from ros2_mcp_bridge.request import Request
from ros2_mcp_common.wire.protocol import Definition, DefinitionsReply, InterfacesReply

_PRIMITIVES = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_FIELD_TYPE = re.compile(r"\s*([A-Za-z][A-Za-z0-9_/]*)")
_FIELD_NAME = re.compile(r"\s*[A-Za-z][^\s#]*\s+([a-z]\w*)(?!\w|\s*=)", re.ASCII)
_INCLUDE = re.compile(r'^\s*#include\s+[<"]([^/>"]+/[^/>"]+/[^/>"]+)\.idl[>"]', re.MULTILINE)
_INTERFACE_FILE = re.compile(r"(msg|srv|action)/([A-Za-z0-9]+)\.(msg|srv|action|idl)$")
_PART = re.compile(r"_[^/]*$")
_USED_BY_ACTIONS = (
    "action_msgs/msg/GoalInfo",
    "action_msgs/msg/GoalStatusArray",
    "action_msgs/srv/CancelGoal",
    "builtin_interfaces/msg/Time",
    "unique_identifier_msgs/msg/UUID",
)


def list_interfaces(_request: Request) -> InterfacesReply:
    """Return the names `package/kind/Name` of all interfaces in the ament index, sorted."""
    found: set[str] = set()
    for prefix in _prefixes():
        for index in prefix.glob("share/ament_index/resource_index/rosidl_interfaces/*"):
            for line in index.read_text("utf-8").splitlines():
                match = _INTERFACE_FILE.match(line.strip())
                if match:
                    found.add(f"{index.name}/{match[1]}/{match[2]}")
    return {"interfaces": sorted(found)}


def find(request: Request) -> DefinitionsReply:
    """Return the definitions of `types` with everything that they refer to, and the list of types that were not found.

    The parts of an action or service (`Fibonacci_FeedbackMessage`) are defined by the whole (`Fibonacci`).
    """
    found: dict[str, Definition] = {}
    missing: list[str] = []
    open_types = request.texts("types").copy()
    while open_types:
        type_name = open_types.pop()
        whole = _PART.sub("", type_name)
        if whole in found or type_name in missing:
            continue
        definition = _read(whole)
        if definition is None:
            missing.append(type_name)
            continue
        found[whole] = definition
        open_types += _references(whole, definition)
    return {"definitions": found, "missing": missing}


def fields_below(type_name: str) -> Iterator[tuple[str, str]]:
    """The fields of a type and of all that it contains, each with the type that has it; of definitions in IDL none."""
    seen: set[str] = set()
    waiting = [_PART.sub("", type_name)]
    while waiting:
        name = waiting.pop(0)
        definition = None if name in seen else _read(name)
        seen.add(name)
        if definition is None:
            continue
        if definition["format"] != "idl":
            for line in definition["text"].splitlines():
                if found := _FIELD_NAME.match(line):
                    yield name, found[1]
        waiting += _references(name, definition)


def _prefixes() -> list[Path]:
    listed = os.environ.get("AMENT_PREFIX_PATH") or sys.prefix
    return [Path(prefix) for prefix in listed.split(os.pathsep) if prefix]


def _read(type_name: str) -> Definition | None:
    parts = type_name.split("/")
    if len(parts) != 3 or not all(re.fullmatch(r"[A-Za-z0-9_]+", part) for part in parts):
        return None
    package, kind, name = parts
    for prefix in _prefixes():
        for form in (kind, "idl"):
            path = prefix / "share" / package / kind / f"{name}.{form}"
            if path.is_file():
                return {"format": form, "text": path.read_text("utf-8")}
    return None


def _references(type_name: str, definition: Definition) -> list[str]:
    package, kind, _ = type_name.split("/")
    if definition["format"] == "idl":
        found = set(_INCLUDE.findall(definition["text"]))
    else:
        lines = (_FIELD_TYPE.match(line) for line in definition["text"].splitlines())
        names = [line[1].split("/") for line in lines if line and not _PRIMITIVES.fullmatch(line[1])]
        found = {f"{parts[0] if len(parts) > 1 else package}/msg/{parts[-1]}" for parts in names}
    return sorted(found.union(_USED_BY_ACTIONS if kind == "action" else ()))
