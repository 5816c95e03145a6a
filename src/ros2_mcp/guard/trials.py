"""Trials of a policy with commands that are never sent: for `ros2-mcp policy explain` and `test`, without a robot.

A trial is one row of a table, whose columns `tests/unit/guard/profiles/FORMAT.md` describes.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from ros2_mcp.guard.exact import leaves_of
from ros2_mcp.guard.policy import ALLOWED, VERBS, Decision, Facts, Policy
from ros2_mcp.model import commands, names
from ros2_mcp.model.commands import LOCAL, Command
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.qos import Choice, QoS
from ros2_mcp_common.policy.checks import Checks
from ros2_mcp_common.policy.curves import State
from ros2_mcp_common.policy.field_values import number_of
from ros2_mcp_common.policy.rules import Ruling, judged_part
from ros2_mcp_common.policy.stamps import trajectories_in
from ros2_mcp_common.policy.trajectory_limits import Joints, LookAtJoints
from ros2_mcp_common.policy.verbs import CHANGE_STATE, SET_PARAMETERS, Verb, meaning

DECISIONS: Mapping[str, str] = {"allowed": "allow", "refused": "refuse", "consent": "consent"}
"""The words for the verdicts in tables."""
_COLUMNS = ("verb", "name", "type", "value", "rate_hz", "duration_s", "facts", "decision")
_TYPED = ("publish", "relay", "play", "call", "goal")
"""The verbs whose rules check the type."""
_REQUESTS: Mapping[str, Sequence[str]] = {"set": ("parameters",), "goal": ("goal_id", "goal")}
"""The fields of service requests that are judged under another verb than `call`."""
_Fields = dict[str, Any]
_CHOICE = Choice(QoS(), "a trial")
_GOAL_ID = "0" * 31 + "1"
_HEADED: Mapping[str, str] = {
    "geometry_msgs/msg/TwistStamped": "twist",
    "geometry_msgs/msg/PoseStamped": "pose",
    "ackermann_msgs/msg/AckermannDriveStamped": "drive",
}
"""Types that consist of a header and one field: paths may omit the name of that field."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One command as written in a table; fields omitted in `value` have their defaults.

    `publishers` are the robot's nodes that publish on the topic; `own`: a cancellation is of this server's own goal.
    `joints` are positions of joints; any other joint is at the first point of its trajectory.
    """

    verb: str
    name: str
    type: str = ""
    value: Any = field(default_factory=dict[str, Any])
    rate_hz: float | None = None
    duration_s: float | None = None
    publishers: Sequence[str] = ()
    own: bool = False
    joints: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A trial with its line in the table and the expected decision."""

    line: int
    trial: Trial
    expected: str


def rows_of(path: Path) -> Iterator[Row]:
    """Yield the rows of a table.

    Raises:
        BadInput: with file and line, if the table is invalid.
    """
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        if missing := [name for name in _COLUMNS if name not in (reader.fieldnames or ())]:
            raise BadInput(f"{path}: there is no column {missing[0]}.", f"The first row names: {', '.join(_COLUMNS)}.")
        for row in reader:
            try:
                expected = row["decision"].strip()
                if expected not in DECISIONS.values():
                    raise BadInput(f"{expected!r} is not a decision.", f"It is {', '.join(DECISIONS.values())}.")
                yield Row(line=reader.line_num, trial=trial_of(row), expected=expected)
            except BadInput as error:
                raise BadInput(f"{path}:{reader.line_num}: {error}") from error
            except AttributeError as error:
                raise BadInput(
                    f"{path}:{reader.line_num}: this row does not have as many columns as the first."
                ) from error


def trial_of(row: Mapping[str, str]) -> Trial:
    """Return the trial of one row. Raises `BadInput`."""
    verb = row["verb"].strip()
    if verb not in VERBS:
        raise BadInput(f"There is no verb {verb!r}.", names.did_you_mean(verb, VERBS, f"It is {', '.join(VERBS)}."))
    if verb in _TYPED and not row["type"].strip():
        raise BadInput(f"No type is given: what {verb} means to a policy depends on it.")
    found = _json(row, "facts")
    if not isinstance(found, dict):
        raise BadInput("Column facts is not a JSON object.", 'Such as {"publishers": ["/controller_server"]}.')
    facts = cast("Mapping[str, Any]", found)
    return Trial(
        verb=verb,
        name=row["name"].strip() if verb == "record" else names.absolute(row["name"]),
        type=row["type"].strip(),
        value=_json(row, "value"),
        rate_hz=_number(row, "rate_hz"),
        duration_s=_number(row, "duration_s"),
        publishers=tuple(facts.get("publishers", ())),
        own=bool(facts.get("own", False)),
        joints=dict(facts.get("joints", {})),
    )


def decided(policy: Policy, trial: Trial) -> Decision:
    """Return the policy's decision. Cancelling a goal of this server is always allowed."""
    if trial.verb == "cancel" and trial.own:
        return ALLOWED
    command = _command(trial)
    trial = _as_meant(trial)
    ruling = policy.ruling(command)
    value = _filled(trial, ruling) if ruling else trial.value
    facts = Facts(value=value, publishers=trial.publishers, joints=_joints_of(value, trial.joints))
    return policy.judge(command, ruling, facts, policy.mode)


def _joints_of(value: Any, given: Mapping[str, float]) -> LookAtJoints:
    """Return joints at rest: at the given positions, otherwise at the first point of the trajectory."""
    stand: dict[str, State] = {}
    for _, found in trajectories_in(value):
        points = cast("Sequence[Mapping[str, Any]]", found["points"])
        first = zip(found["joint_names"], points[0].get("positions", ()), strict=False) if points else ()
        stand |= {str(name): State(number_of(at, "positions"), 0.0) for name, at in first}
    stand |= {name: State(float(at), 0.0) for name, at in given.items()}
    return lambda _names: Joints(stand)


def _as_meant(trial: Trial) -> Trial:
    """Convert a call that sends a goal or sets parameters to a trial of that verb."""
    if trial.verb != "call":
        return trial
    meant = meaning(trial.name, trial.type)
    return replace(trial, verb=meant.verb, value=_judged(meant.verb, trial.value))


def _judged(verb: Verb, request: Any) -> Any:
    """Return the part of a request that rules check. Raises `BadInput` for an invalid request."""
    if wrong := [name for name in request if name not in _REQUESTS.get(verb, request)]:
        raise BadInput(f"That service takes no {wrong[0]!r}.", f"It takes {' and '.join(_REQUESTS[verb])}.")
    given: dict[str, Any] = {"goal": {}, "parameters": [], **request}
    try:
        return judged_part(verb, given) if verb in ("goal", "set") else request
    except Exception as error:  # an error of `judged_part`: a parameter without a name or a value
        raise BadInput(f"This is not a request of that service: {error}.") from error


def _json(row: Mapping[str, str], column: str) -> Any:
    try:
        return json.loads(row[column] or "{}")
    except ValueError as error:
        raise BadInput(f"Column {column} is not JSON: {error}.", 'A string needs quotes: "activate".') from error


def _number(row: Mapping[str, str], column: str) -> float | None:
    text = row[column].strip()
    try:
        return float(text) if text else None
    except ValueError as error:
        raise BadInput(f"Column {column} is not a number: {text!r}.") from error


def unbounded(policy: Policy, trial: Trial) -> list[str]:
    """Return the paths in the value that no rule or limit checks. A misspelt path is among them, because the fields of
    a type are not known without the robot.
    """
    ruling = policy.ruling(_command(trial))
    trial = _as_meant(trial)
    if ruling is None or trial.verb not in _TYPED:
        return []
    only = _HEADED.get(trial.type, "")
    looked_at = [
        path.replace("[]", "").removeprefix(f"{only}." if only else "")
        for part in (*ruling.allowances, *ruling.limits)
        for path, _ in _defaults(part.checks)
    ]
    written = [re.sub(r"\[\d+\]", "", path) for path, _ in leaves_of(trial.value)]
    inner = [path.removeprefix(f"{only}." if only else "") for path in written]
    return [
        path
        for path, plain in dict(zip(written, inner, strict=True)).items()
        if not any(f"{plain}.".startswith(f"{known}.") for known in looked_at)
    ]


def _command(trial: Trial) -> Command[Any]:
    common = _Fields(principal=LOCAL, name=trial.name, type=trial.type, value=trial.value)
    timed = _Fields(common, rate_hz=trial.rate_hz, duration_s=trial.duration_s or 0.0, wait_match_s=0.0)
    asked = _Fields(common, timeout_s=5.0)
    match trial.verb:
        case "publish" if trial.rate_hz is None and trial.duration_s is None:
            return commands.Publish(**common, choice=_CHOICE, wait_match_s=0.0)
        case "publish":
            return commands.Repeat(**_Fields(timed, rate_hz=trial.rate_hz or 1.0), choice=_CHOICE)
        case "relay":
            return commands.Relay(**timed, relay_id="", qos=QoS(), source="/elsewhere")
        case "play":
            return commands.Play(**timed, relay_id="", qos=QoS(), bag="trial", topic=trial.name)
        case "record":
            return commands.Record(principal=LOCAL, name="trial", topics=tuple(trial.name.split()))
        case "set":
            asked |= {"type": SET_PARAMETERS, "through": f"{trial.name}/set_parameters"}
            return commands.SetParameters(**asked, parameters=dict(trial.value))
        case "transition":
            asked |= {"type": CHANGE_STATE, "through": f"{trial.name}/change_state"}
            return commands.ChangeState(**asked, transition=str(trial.value))
        case "goal":
            return commands.SendGoal(**asked, goal_id=_GOAL_ID)
        case "cancel":
            return commands.CancelGoals(**_Fields(asked, type=commands.CANCEL_TYPE))
        case _:
            return commands.ServiceCall(**asked)


# ── defaults, as far as the rules ask for them ─────────────────────────────────────────────────────────────────────


def _filled(trial: Trial, ruling: Ruling) -> Any:
    """Return the value with every field that a rule checks; omitted fields have their defaults."""
    copied: Any = json.loads(json.dumps(trial.value))
    if trial.verb in ("set", "transition") or not isinstance(copied, dict):
        return copied  # parameters that are not set have no default
    value = cast("dict[str, Any]", copied)
    if only := _HEADED.get(trial.type):
        value = {"header": {"frame_id": ""}, only: {}} | value
    for checks in (part.checks for part in (*ruling.allowances, *ruling.limits)):
        for path, default in _defaults(checks):
            steps = [step for step in path.replace("[]", ".[]").split(".") if step]
            if only and steps and steps[0] not in (only, "header"):
                steps.insert(0, only)
            _fill(value, steps, default)
    return value


def _defaults(checks: Checks) -> Iterator[tuple[str, Any]]:
    """Yield the paths that are checked, each with the default of such a field."""
    vector = {"x": 0.0, "y": 0.0, "z": 0.0}
    yield from ((path, vector) for path in (*checks.norm, *checks.zone))
    yield from ((path, 0.0) for path in (*checks.zero, *checks.range))
    yield from ((path, type(choices[0])()) for path, choices in checks.one_of.items())
    yield from ((path, list[Any]()) for path in checks.count)
    points = [*checks.pace, *(f"{path}.points".lstrip(".") for path in checks.curve)]
    for path in points:
        yield path, list[Any]()
        yield from ((f"{path}[].{name}", list[Any]()) for name in ("positions", "velocities", "accelerations"))
        yield from ((f"{path}[].time_from_start.{part}", 0) for part in ("sec", "nanosec"))
    for path in checks.curve:
        yield f"{path}.joint_names".lstrip("."), list[Any]()
        yield from ((f"{path}.header.stamp.{part}".lstrip("."), 0) for part in ("sec", "nanosec"))


def _fill(value: Any, steps: Sequence[str], default: Any) -> None:
    """Add one field with its default, and the objects and lists above it, unless they exist."""
    if not isinstance(value, (dict, list)) or not steps:
        return
    step, rest = steps[0], steps[1:]
    if step == "[]":
        for element in cast("list[Any]", value) if isinstance(value, list) else ():
            _fill(element, rest, default)
        return
    if isinstance(value, dict):
        fields = cast("dict[str, Any]", value)
        if not rest and isinstance(default, dict) and isinstance(fields.get(step), dict):
            fields[step] = default | fields[step]
        fields.setdefault(step, json.loads(json.dumps(default)) if not rest else [] if rest[0] == "[]" else {})
        _fill(fields[step], rest, default)
