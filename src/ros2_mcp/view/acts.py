"""Prepare audit entries for display: commands with their outcomes, requests with their answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from ros2_mcp.model.times import iso_time

MOST_ACTS = 60
"""The number of entries that a page shows: the newest."""
_MOST_TEXT = 300
"""Characters of a field: the audit writes no longer fields."""
_ANSWERS = ("approved", "denied", "granted", "withdrawn")
"""Answers to a request for approval."""
_KINDS = (
    *("act", "waits", "refused", "goal ended", "stop", "stopped", "latched", "reset", "mode"),
    *(*_ANSWERS, "revoked"),
)
"""Kinds of lines that are shown; outcomes are shown with their commands."""
_TEXTS = ("tool", "verb", "name", "type", "by", "reason", "rule", "program", "outcome", "now", "approval")
_NUMBERS = ("rate_hz", "duration_s", "for_s")
_OF_A_STOP = ("stop", "latched", "stopped")
"""Lines that each server writes for one press of the stop button."""
_PRESS_S = 20.0
"""Seconds from the first of these lines to the last: the stop waits for servers that hang."""

Line = Mapping[str, Any]


def acts_in(lines: Sequence[Line]) -> Iterator[Mapping[str, Any]]:
    """Yield the entries to show, the oldest first, from lines of the audit.

    `outcome` is the outcome of a command so far, or the answer to a call that waits for approval. Two kinds of repeats
    are shown once: a server finding the latch still set, and the same call still waiting. Lines from a recording are
    untrusted: a field of an unexpected type is shown as text or omitted.
    """
    outcomes = {str(line.get("of")): str(line.get("outcome", "")) for line in lines if line.get("kind") == "outcome"}
    answers = {_request(line): str(line["kind"]) for line in lines if line.get("kind") in _ANSWERS}
    latched: tuple[object, object] | None = None
    asked: set[str] = set()
    for line in lines:
        kind = line.get("kind")
        if kind not in _KINDS:
            continue
        if kind in ("latched", "reset"):
            before = latched
            latched = (line.get("by"), line.get("reason")) if kind == "latched" else None
            if kind == "latched" and latched == before:
                continue
        act = _told(line)
        if kind == "act":
            act["outcome"] = outcomes.get(str(line.get("seq")), "")
        if kind == "waits" and (request := _request(line)):
            if request in asked:
                continue
            asked.add(request)
            act |= {"outcome": answers.get(request, ""), "reason": ""}
        yield act


def presses_as_one(acts: Sequence[Line]) -> list[Line]:
    """Merge the entries of one stop (asked for, latch set, robot at rest) into one entry.

    Its outcome is the stage that was reached. A latch without a stop, and entries after a reset, stay separate.
    """
    found: list[Line] = []
    begun: dict[object, tuple[int, float, set[str]]] = {}
    for act in acts:
        kind, by, at_s = act["kind"], act.get("by"), _seconds(act["time"])
        if kind == "reset":
            begun.clear()
        if kind not in _OF_A_STOP or at_s is None:
            found.append(act)
            continue
        index, began_s, kinds = begun.get(by, (0, -_PRESS_S, set[str]()))
        if abs(at_s - began_s) >= _PRESS_S:
            index, began_s, kinds = len(found), at_s, set[str]()
            found.append(act)
        kinds |= {kind, act.get("outcome") or kind}
        begun[by] = index, began_s, kinds
        if len(kinds) > 1 or kind == "stopped":
            ends = [word for word in ("not confirmed", "stopped", "latched") if word in kinds]
            ends = ends[:1] + ends[2:] if ends[:2] == ["not confirmed", "stopped"] else ends
            known = {name: value for name, value in {**act, **found[index]}.items() if value not in (None, "")}
            found[index] = {**known, "kind": "stop", "outcome": ", ".join(ends)}
    return found


def _seconds(time: str) -> float | None:
    try:
        return datetime.fromisoformat(time.replace("Z", "+00:00")).timestamp()
    except (ValueError, OverflowError):  # a recording may contain anything
        return None


def told_as_lapsed(acts: Sequence[Line], waits_no_longer: Callable[[Line], bool]) -> list[Line]:
    """Mark calls that were never answered and no longer wait for approval with the outcome `not answered`."""
    return [
        {**act, "outcome": "not answered"}
        if act["kind"] == "waits" and not act.get("outcome") and waits_no_longer(act)
        else act
        for act in acts
    ]


def _told(line: Line) -> dict[str, Any]:
    kind, number = line["kind"], line.get("seq")
    fields: dict[str, Any] = {name: str(line[name])[:_MOST_TEXT] for name in _TEXTS if line.get(name)}
    fields |= {name: line[name] for name in _NUMBERS if type(line.get(name)) in (int, float)}
    if kind in (*_ANSWERS, "revoked"):  # the request or grant to which the line refers
        fields |= {"name": fields.pop("approval", "")}
    if kind == "stopped" and line.get("confirmed") is False:
        fields |= {"outcome": "not confirmed"}
    if line.get("what"):
        fields |= {"reason": str(line["what"])[:_MOST_TEXT]}
    return {
        "time": str(line.get("time", iso_time(0))),
        "kind": kind,
        "who": str(line.get("principal", "")),
        **fields,
        "seq": number if isinstance(number, int) else None,
        "value": line.get("value"),
    }


def _request(line: Line) -> str:
    """Return the id of the request to which a line refers; a grant has an id of its own, too."""
    return str((line.get("kind") == "granted" and line.get("of")) or line.get("approval") or "")
