"""Policies on the command line: check, explain, compare, test, and draft from the live graph."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import json
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from ros2_mcp.guard import trials, words
from ros2_mcp.guard.document import Document
from ros2_mcp.guard.policy import Decision, Policy
from ros2_mcp.guard.policy_file import compiled, read_policy
from ros2_mcp.guard.watch import most_of
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput
from ros2_mcp.settings import Settings
from ros2_mcp_common.policy.rules import RuleSet

_MEANT: Mapping[str, str] = {"allowed": "ALLOWED", "refused": "REFUSED", "consent": "A PERSON HAS TO APPROVE"}
_TOLD: Mapping[str, Callable[[RuleSet], list[str]]] = {
    "allow": words.allowed,
    "limits": words.limits,
    "forbid": words.forbidden,
}
"""The lists of rules in a policy, each with the function that describes its entries in words."""
_DRIVING = ("publish", "relay", "play", "goal")
"""Verbs that may drive the robot, to which the watchdog applies."""
_FORM = (
    "VERB NAME [TYPE] [JSON] [rate_hz=N] [duration_s=N], such as: "
    'publish /cmd_vel geometry_msgs/msg/Twist {"linear": {"x": 0.1}}'
)


def check(which: str) -> int:
    """Print a policy in words. Mistakes raise errors with file and line."""
    document = read_policy(which)
    print(f"{document.name}: in order. sha256 {_policy(document).digest}")
    print(f"mode {document.mode}")
    for kind, told in _TOLD.items():
        _print_list(kind, told(document.rules))
    _print_list("watched", _watched(document))
    return 0


def _print_list(kind: str, lines: Sequence[str]) -> None:
    print(f"{kind}:" if lines else f"{kind}: nothing")
    for line in lines:
        print(f"  {line}")


def _watched(document: Document) -> list[str]:
    return words.watched(document, most_of(_policy(document)))


def explain(which: str, command: str) -> int:
    """Print the decision about one command, the rule behind it, and what would be allowed. Return 1 if it
    is refused.
    """
    document, trial = read_policy(which), _trial(command)
    policy = _policy(document)
    decision = trials.decided(policy, trial)
    print(_MEANT[decision.verdict])
    free = [] if decision.verdict == "refused" else trials.unbounded(policy, trial)
    for title, text in (
        ("by", decision.rule),
        ("because", decision.reason),
        ("allowed", decision.instead),
        ("not bounded", f"{', '.join(free)} (whether there is such a field only the robot knows)" if free else ""),
    ):
        if text:
            print(f"  {title}: {text}")
    if decision.verdict != "refused" and trial.verb in _DRIVING:
        for line in _watched(document):
            print(f"  watched: {line}")
    return 1 if decision.verdict == "refused" else 0


def diff(one: str, other: str) -> int:
    """Print each difference of two policies with its path in the file. Return 1 if there is any."""
    documents = read_policy(one), read_policy(other)
    before, after = (_without_rules(document.form) for document in documents)
    changes = [*_rule_changes(*documents), *_changes(before, after)]
    print("\n".join(changes) or "No difference.")
    return 1 if changes else 0


def test(which: str, table: Path) -> int:
    """Test a policy against a table, and print the rows that it decides differently. Return 1 if there are any."""
    policy = _policy(read_policy(which))
    rows = list(trials.rows_of(table))
    wrong = [(row, decision) for row in rows if _said(decision := trials.decided(policy, row.trial)) != row.expected]
    for row, decision in wrong:
        why = decision.reason or decision.rule
        print(f"{table}:{row.line}: expected {row.expected}, decided {_said(decision)}: {why}")
    print(f"{len(rows) - len(wrong)} of {len(rows)} rows as written.")
    return 1 if wrong else 0


def init(settings: Settings, output: Path | None) -> int:
    """Write a draft from the live graph: to a new file that only its owner can write, or to stdout."""
    text = asyncio.run(_draft(settings))
    if output is None:
        print(text, end="")
        return 0
    try:
        descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    except FileExistsError:
        raise BadInput(f"{output} is there already.", "Name another file: a policy is never overwritten.") from None
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(text)
    print(f"{output} is written. Read it, then: ros2-mcp policy check {output}")
    return 0


async def _draft(settings: Settings) -> str:
    from ros2_mcp.compose.robot import connect
    from ros2_mcp.ops.policy.draft import draft

    async with connect(settings) as robot:
        return await draft(robot)


def _policy(document: Document) -> Policy:
    return Policy(documents=(document,), rules=compiled([document]))


def _said(decision: Decision) -> str:
    return trials.DECISIONS[decision.verdict]


def _trial(command: str) -> trials.Trial:
    """Parse the trial of a command line; JSON in it may be quoted or not."""
    verb, _, rest = command.strip().partition(" ")
    name, _, rest = rest.strip().partition(" ")
    if not name:
        raise BadInput(f"{command!r} is not a command.", f"Write {_FORM}")
    row = dict.fromkeys(("type", "value", "rate_hz", "duration_s", "facts"), "") | {"verb": verb, "name": name}
    rest, row["value"] = _json_in(rest)
    for word in shlex.split(rest):
        key, equals, text = word.partition("=")
        if equals and key in ("rate_hz", "duration_s"):
            row[key] = text
        elif not equals and "/" in word and not row["type"]:
            row["type"] = _full_type(verb, word)
        else:
            raise BadInput(f"{word!r} is not understood.", f"Write {_FORM}")
    return trials.trial_of(row)


def _json_in(text: str) -> tuple[str, str]:
    """Return the text around a JSON value, and the value; "" if there is none."""
    at = min((text.find(mark) for mark in '{["' if mark in text), default=-1)
    if at < 0:
        return text, ""
    try:
        _, end = json.JSONDecoder().raw_decode(text[at:])
    except ValueError as error:
        raise BadInput(f"{text[at:]!r} is not JSON: {error}.", f"Write {_FORM}") from None
    return f"{text[:at].rstrip(chr(39))} {text[at + end :].lstrip(chr(39))}", text[at : at + end]


def _full_type(verb: str, word: str) -> str:
    return names.interface_type(word, {"goal": "action", "call": "srv"}.get(verb, "msg"))


def _rule_changes(one: Document, other: Document) -> Iterator[str]:
    """Yield the rules that only one of two policies has, in words: the order and place of rules have no meaning."""
    for kind, told in _TOLD.items():
        before, after = (list(zip(each.form["rules"][kind], told(each.rules), strict=False)) for each in (one, other))
        for sign, these, those in (("-", before, after), ("+", after, before)):
            yield from (f"{sign} {kind}: {said}" for form, said in these if form not in [form for form, _ in those])


def _without_rules(form: Mapping[str, Any]) -> dict[str, Any]:
    rules = {key: value for key, value in form["rules"].items() if key not in (*_TOLD, "name")}
    return {**form, "rules": rules}


def _changes(one: Any, other: Any, path: str = "") -> Iterator[str]:
    """Yield the differences of two values as `path: before → after`."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        before, after = cast("Mapping[str, Any]", one), cast("Mapping[str, Any]", other)
        for key in dict.fromkeys([*before, *after]):
            yield from _changes(before.get(key), after.get(key), f"{path}.{key}".lstrip("."))
    elif one != other:
        yield f"{path.removeprefix('rules.')}: {_shown(one)} → {_shown(other)}"


def _shown(value: Any) -> str:
    return "nothing" if value is None else json.dumps(value, ensure_ascii=False)
