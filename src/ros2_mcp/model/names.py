"""ROS names of topics, services, nodes and interface types: validated and brought into one form."""

from __future__ import annotations

import difflib
import fnmatch
import re
from collections.abc import Callable, Iterable, Sequence

from ros2_mcp.model.errors import BadName
from ros2_mcp.model.text import named, quoted

_NAME = re.compile(r"^(/[A-Za-z_][A-Za-z0-9_]*)+$")
KINDS = ("msg", "srv", "action")
"""Kinds of interfaces."""
_SHORT_TYPE = re.compile(r"^[A-Za-z][A-Za-z0-9_]*$")
_TYPE = re.compile(r"^(?P<package>[a-z][a-z0-9_]*)/(?:(?P<kind>msg|srv|action)/)?(?P<name>[A-Za-z][A-Za-z0-9_]*)$")

_LONGEST = 247
"""Characters of a name: the middleware's 255 without the prefix and suffix that ROS adds
(`rmw_validate_full_topic_name`)."""

UNKNOWN_NODE = "(unknown node)"
"""Placeholder for a name that the middleware does not know yet: it arrives a little after the node's endpoints."""
_NAMELESS = {"_NODE_NAME_UNKNOWN_": UNKNOWN_NODE, "_CREATED_BY_BARE_DDS_APP_": "(not a ROS node)"}


def absolute(name: str, what: str = "topic") -> str:
    """Return the fully qualified name: `/scan` for `scan` and `/scan`.

    Raises:
        BadName: if ROS 2 does not allow the name.
    """
    full = name.strip()
    if full.startswith("~"):
        raise BadName(
            f"{quoted(name)} is private to a node.", f"Give the full {what} name, such as /node_name{full[1:]}."
        )
    if not full.startswith("/"):
        full = "/" + full
    if not _NAME.match(full):
        raise BadName(
            f"{quoted(name)} is not a valid {what} name.",
            "A name is made of parts like /robot1/scan: letters, digits and underscores, not starting with a digit.",
        )
    if len(full) > _LONGEST:
        raise BadName(f"{quoted(name)} has {len(full)} characters.", f"A {what} name has at most {_LONGEST}.")
    return full


def is_valid(name: str) -> bool:
    """Return whether ROS 2 allows the name of a topic, with or without the leading slash."""
    try:
        return bool(absolute(name))
    except BadName:
        return False


def node_name(name: str) -> tuple[str, str]:
    """Return name and namespace of a node: `("driver", "/arm")` for `/arm/driver`."""
    full = absolute(name, "node")
    namespace, _, base = full.rpartition("/")
    return base, namespace or "/"


def full_node_name(name: str, namespace: str) -> str:
    """Join name and namespace; return a placeholder for a node that the middleware does not know."""
    if name in _NAMELESS:
        return _NAMELESS[name]
    return f"{namespace.rstrip('/')}/{name}"


def interface_type(name: str, kind: str) -> str:
    """Return the full type name: `std_msgs/msg/String` for `std_msgs/String` and `std_msgs.msg.String`.

    Raises:
        BadName: if it is not a type's name, or not of the kind `kind` (`msg`, `srv` or `action`).
    """
    match = _TYPE.match(name.strip().replace(".", "/").replace("::", "/"))
    if match is None:
        raise BadName(f"{quoted(name)} is not the name of a type.", f"Write it as package/{kind}/Name.")
    found = match["kind"] or kind
    if found != kind:
        raise BadName(f"{quoted(name)} is a {found} type, but a {kind} type is needed here.")
    return f"{match['package']}/{kind}/{match['name']}"


def is_short(type_name: str) -> bool:
    """Return whether the name is that of a type without its package, such as `Twist`."""
    return bool(_SHORT_TYPE.match(type_name.strip()))


def is_type(requested: str, full: str, kind: str = "msg") -> bool:
    """Return whether `requested` (`Twist`, `geometry_msgs/Twist` or the full name) means the type `full`.

    Raises:
        BadName: if it is not a type's name, or of another kind.
    """
    if is_short(requested):
        return requested.strip() == full.rpartition("/")[2]
    return interface_type(requested, kind) == full


_DERIVED = re.compile(
    r"(?<=/)(?P<base>\w+?)_(SendGoal|GetResult|SendGoal_Request|SendGoal_Response|GetResult_Request|GetResult_Response"
    r"|SendGoal_Event|GetResult_Event|FeedbackMessage|Feedback|Goal|Result|Request|Response|Event)$"
)


def defining_type(name: str) -> str:
    """Return the interface whose file defines a type: `a/action/Go` for `a/action/Go_SendGoal_Request`."""
    if name.count("/") != 2:  # for example a JSON type in a recording, which defines itself
        return name
    package, kind, base = name.split("/")
    match = _DERIVED.search(name) if kind != "msg" else None
    return f"{package}/{kind}/{match['base'] if match else base}"


def is_derived(name: str) -> bool:
    """Return whether the type is a part of a service or an action, such as `a/action/Go_FeedbackMessage`."""
    return name.count("/") == 2 and defining_type(name) != name


def type_in_words(name: str) -> str:
    """Return a readable type: `the request of std_srvs/srv/SetBool` for `std_srvs/srv/SetBool_Request`."""
    if not is_derived(name):
        return name
    whole = defining_type(name)
    part = name.removeprefix(f"{whole}_").removesuffix("Message").rpartition("_")[2].lower()
    return f"the {part} of {whole}"


def is_of_action(name: str) -> bool:
    """Return whether the name is that of a topic or service of an action, such as `/dock/_action/status`."""
    return "/_action/" in name


def is_hidden(name: str) -> bool:
    """Return whether ROS hides the name by convention: a part of it begins with an underscore."""
    return "/_" in name


def matching(names: Iterable[str], pattern: str, types_of: Callable[[str], Sequence[str]] = lambda _: ()) -> list[str]:
    """Return the names that match a pattern themselves or by a type.

    A pattern with `*`, `?` or `[` is a glob, any other one a part of the name or type; the empty pattern matches all.
    """
    if not pattern:
        return list(names)
    if any(sign in pattern for sign in "*?["):
        return [name for name in names if any(fnmatch.fnmatchcase(text, pattern) for text in (name, *types_of(name)))]
    part = pattern.lower()
    return [name for name in names if any(part in text.lower() for text in (name, *types_of(name)))]


def nearest(name: str, known: Sequence[str]) -> str:
    """Return the known name that `name` was most likely meant to be, or an empty string."""
    by_folded = {candidate.lower(): candidate for candidate in known}
    close = difflib.get_close_matches(name.lower(), list(by_folded), n=1, cutoff=0.6)
    return by_folded[close[0]] if close else ""


def may_be_one(one: str, other: str) -> bool:
    """Return whether two frame names may mean one frame: misspelt, or with a prefix that the other lacks.

    Names that differ in a number, or have two different prefixes, are those of different frames.
    """
    if one.rpartition("/")[2].lower() == other.rpartition("/")[2].lower():
        return ("/" in one) != ("/" in other) or one.lower() == other.lower()
    if re.findall(r"\d+", one) != re.findall(r"\d+", other):
        return False
    return difflib.SequenceMatcher(None, one.lower(), other.lower()).ratio() >= _ALIKE


_ALIKE = 0.85
"""Least similarity: a missing, wrong or swapped letter in a frame name passes, left instead of right does not."""


def did_you_mean(name: str, known: Sequence[str], otherwise: str = "") -> str:
    """Return a hint for an unknown name: the nearest known name, never the name itself, or `otherwise`."""
    near = nearest(name, [each for each in known if each != name])
    return f"Did you mean {named(near)}?" if near else otherwise
