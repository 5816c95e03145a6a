"""The definitions stored in a bag: one text per type, including the types to which it refers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from ros2_mcp.model.interfaces import Constant, DefinitionText, Interface, Structure
from ros2_mcp.model.names import defining_type, is_derived

_LINE = "=" * 80
_NO_FIELDS = "# It has no fields."  # an empty text would mean that the definition is not known
_PART = re.compile(r"^={80}\r?\n(MSG|IDL|SRV): (\S+)\r?$", re.MULTILINE)
_SIDES = re.compile(r"^---\s*$", re.MULTILINE)
_ENDINGS = {"srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}


def schema_text(interface: Interface) -> str:
    """Return a message type as `ros2msg` text for rosbag2 and Foxglove, with every type to which it refers.

    Default values are omitted: they do not affect the encoding.
    """
    parts = [_structure_text(interface.sides["message"])]
    for name, structure in interface.nested.items():
        package, _, base = name.split("/")
        title = name if is_derived(name) else f"{package}/{base}"
        parts += [f"{_LINE}\nMSG: {title}", _structure_text(structure)]
    return "\n".join(parts)


def definitions_in(type_name: str, encoding: str, text: str) -> dict[str, DefinitionText]:
    """Parse a schema's text into definitions by interface name; empty if the encoding is not known."""
    if encoding not in ("ros2msg", "ros2idl") or not text.strip():
        return {}
    found: dict[str, DefinitionText] = {}
    flat: dict[str, str] = {}
    for name, kind, part in _parts(type_name, encoding, text):
        if kind == "msg" and is_derived(name) and _SIDES.search(part):  # rosbag2 stores the service for its events
            found[defining_type(name)] = DefinitionText("srv", part)
        elif kind == "msg" and is_derived(name):
            flat[name] = part
        elif name.count("/") == 2:
            found[name] = DefinitionText(kind, part)
    return {**_owners(flat), **found}


def bare(text: str) -> str:
    """Return a definition without comments and spacing: neither affects the encoding."""
    lines = (" ".join(line.partition("#")[0].split()) for line in text.splitlines())
    return "\n".join(line for line in lines if line)


def _parts(type_name: str, encoding: str, text: str) -> Iterator[tuple[str, str, str]]:
    """Yield name, format and text of each part; the first part has no title in `ros2msg`."""
    pieces = _PART.split(text)
    if pieces[0].strip() or len(pieces) == 1:
        yield type_name, encoding.removeprefix("ros2"), pieces[0]
    elif pieces[1] == "MSG" or (pieces[1] == "IDL" and _full(pieces[2]) != type_name):
        yield type_name, "msg", ""
    for kind, name, part in zip(pieces[1::3], pieces[2::3], pieces[3::3], strict=True):
        yield _full(name), kind.lower(), part


def _full(name: str) -> str:
    package, *_, base = name.split("/")
    return name if name.count("/") == 2 else f"{package}/msg/{base}"


def _owners(flat: Mapping[str, str]) -> dict[str, DefinitionText]:
    """Reassemble services and actions from their parts (request, response, goal, …), as far as they are present."""
    owners: dict[str, DefinitionText] = {}
    for owner in {defining_type(name) for name in flat}:
        kind = owner.split("/")[1]
        sides = [flat.get(owner + ending) for ending in _ENDINGS[kind]]
        if any(side is not None for side in sides):
            owners[owner] = DefinitionText(kind, "\n---\n".join(side or "" for side in sides))
    return owners


def _structure_text(structure: Structure) -> str:
    lines = [f"{constant.type} {constant.name}={_constant_text(constant)}" for constant in structure.constants]
    for field in structure.fields:
        comment = f" # {field.comment}" if field.comment else ""
        lines.append(f"{_type_text(str(field.type))} {field.name}{comment}")
    return "\n".join(lines) or _NO_FIELDS


def _constant_text(constant: Constant) -> str:
    if isinstance(constant.value, bool):
        return str(constant.value).lower()
    if isinstance(constant.value, str):
        return f'"{constant.value}"' if '"' not in constant.value else f"'{constant.value}'"
    return repr(constant.value)


def _type_text(written: str) -> str:
    """Return a type as in .msg files: `std_msgs/Header`; parts of actions keep their full name.

    `char` becomes `uint8`, its equivalent: the type's hash treats it so, and other readers compare the hash.
    """
    base = re.match(r"[\w/]+", written)
    assert base
    if base[0] == "char":
        return written.replace("char", "uint8", 1)
    return written if is_derived(base[0]) else written.replace("/msg/", "/", 1)
