"""Read policies in YAML: find them, open each once and safely, and compile the rules
(`docs/reference/policy-file.md`).
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import stat
import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from ros2_mcp.guard.document import Auditing, Consent, Document, Feedback, Pose
from ros2_mcp.guard.keep_out_section import keep_out_of, limits_of, polygon
from ros2_mcp.guard.policy import VERBS, Policy
from ros2_mcp.guard.section import PolicyFileError, Section, parse
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.settings import Settings
from ros2_mcp_common.files import PLAIN, is_of_others, others_can_write
from ros2_mcp_common.policy.checks import Checks, Pace, Zone
from ros2_mcp_common.policy.feedback import PARTS
from ros2_mcp_common.policy.rules import Allowance, Forbidden, Limit, Ramp, Rules, RuleSet
from ros2_mcp_common.policy.trajectory_limits import CurveLimits, JointBounds
from ros2_mcp_common.policy.transform_chain import TF
from ros2_mcp_common.wire.limits import MAX_RATE_HZ, MIN_RATE_HZ

SYSTEM_POLICY = (
    Path(os.environ.get("PROGRAMDATA", "C:/ProgramData"), "ros2-mcp", "policy.yaml")
    if sys.platform == "win32"
    else Path("/etc/ros2-mcp/policy.yaml")
)
"""The policy for every server on this machine, whatever a client's configuration says."""
PROFILES: Mapping[str, Path] = {path.stem: path for path in sorted((Path(__file__).parent / "profiles").glob("*.yaml"))}
"""The policies in this package, by the name of their file."""
_TYPED = ("publish", "relay", "play", "call", "goal")
"""The verbs whose rules must give the type: a name alone says little about a message."""
_MAX_BYTES = 1_000_000
"""The largest policy file, in bytes: more than 10,000 rules. A larger file is no policy."""
_KINDS = ("msg", "srv", "action", "*")
_BY_PATH = ("norm", "range", "one_of", "count", "zone", "pace", "curve")
"""The kinds of checks, as `Checks` names them."""
_NAME = re.compile(r"/?(?:\*\*|\*|[A-Za-z_]\w*)(?:/(?:\*\*|\*|[A-Za-z_]\w*))*", re.ASCII)
_MESSAGE = re.compile(r"[a-z]\w*/msg/[A-Z]\w*", re.ASCII)
_PATH = re.compile(r"[A-Za-z]\w*(?:\[\])*(?:\.[A-Za-z]\w*(?:\[\])*)*", re.ASCII)


# ── finding and opening ────────────────────────────────────────────────────────────────────────────────────────────


def policy_for(settings: Settings) -> Policy:
    """Return the policy that the settings name. Each combination of settings is read only once per process.

    Raises:
        PolicyFileError: with file, line, and the correct form.
    """
    return _policy(settings.policy, settings.read_only)


@lru_cache
def _policy(chosen: tuple[str, ...], read_only: bool) -> Policy:
    documents = read_policies(chosen)
    return Policy(read_only, documents=documents, rules=compiled(documents) if documents else None)


def read_policies(chosen: Sequence[str], system: Path | None = None) -> list[Document]:
    """Read the policies in force: the system's policy, if it exists, and each chosen file or profile.

    Raises:
        PolicyFileError: with file, line, and the correct form.
    """
    system = system or SYSTEM_POLICY
    documents = [read_policy(str(system))] if os.path.lexists(system) else []
    documents += [read_policy(choice) for choice in chosen]
    for key in ("feedback", "pose"):
        _check_said_once(key, [document for document in documents if document.form[key]])
    for document in documents:
        _check_watched(document, documents)
    return documents


def _check_watched(document: Document, documents: Sequence[Document]) -> None:
    """Raise an error for keep-out zones that no pose in their frame, or no speed, would watch."""
    if document.keep_out is None:
        return
    frame_id = document.keep_out.frame_id
    pose = next((one.pose for one in documents if one.pose), None)
    if pose is None or all(one.feedback is None for one in documents):
        missing = "pose" if pose is None else "feedback"
        problem = f"keep_out needs {missing!r}: without it nothing sees whether the robot drives into a zone."
        base = "pose: {topic: /tf, frame: map, base: base_footprint}"
        raise PolicyFileError(document.origin, 0, problem, f"Such as {base}, and feedback: {{topic: /odom}}.")
    if pose.frame_id != frame_id:
        problem = (
            f"keep_out is in the frame {frame_id!r}, and pose in {pose.frame_id!r}: neither says where the other is."
        )
        raise PolicyFileError(document.origin, 0, problem, f"Write frame: {pose.frame_id} in both.")
    least_m = document.keep_out.least_margin_m(pose.brake_mps2, pose.brake_radps2)
    if document.keep_out.margin_m < least_m:
        speeds = f"brake_mps2 {pose.brake_mps2:g} and brake_radps2 {pose.brake_radps2:g}"
        problem = f"the margin_m of keep_out is too small for this outline with {speeds}: it would be stopped too late."
        raise PolicyFileError(document.origin, 0, problem, f"Write margin_m: {math.ceil(least_m * 100) / 100:g}.")


def _check_said_once(key: str, documents: Sequence[Document]) -> None:
    """Raise an error if two policies differ in how the robot is watched: only the first would be in force."""
    for document in documents[1:]:
        first = documents[0]
        zones = [one.pose and one.rules.zones.get(one.pose.zone) for one in (first, document)]
        if first.form[key] != document.form[key] or (key == "pose" and zones[0] != zones[1]):
            problem = f"the policy {first.name} has another {key!r}, and only one can be in force."
            raise PolicyFileError(document.origin, 0, problem, "Leave it out in one of the two.")


def read_policy(choice: str) -> Document:
    """Read one policy: the profile with that name, otherwise the file. Raises `PolicyFileError`."""
    if choice in PROFILES:  # first: a file in the working folder must not replace a profile
        return document_of(PROFILES[choice].read_text("utf-8"), f"profile {choice}")
    if re.fullmatch(r"[a-z0-9-]+", choice) and not os.path.lexists(choice):
        hint = did_you_mean(choice, list(PROFILES), f"Profiles: {', '.join(PROFILES)}; or give a file.")
        raise PolicyFileError(choice, 0, "there is no such profile or file.", hint)
    return document_of(opened(Path(choice)), choice)


def opened(path: Path) -> str:
    """Read a policy file that no other user can change: a regular file and no link, and it and its folder are writable
    only by their owner, who is root or the user of this process.

    Raises:
        PolicyFileError: if this does not hold, or the file cannot be read.
    """
    path, origin = path.expanduser(), str(path)
    try:
        with os.fdopen(_opened(path, origin), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise PolicyFileError(origin, 0, "it is not a regular file.")
            _check_owner(status, origin, "it")
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        what = "it is a link; name the file itself" if error.errno == errno.ELOOP else error.strerror or str(error)
        raise PolicyFileError(origin, 0, f"it cannot be read: {what}.") from None
    if len(data) > _MAX_BYTES:
        raise PolicyFileError(origin, 0, f"it has more than {_MAX_BYTES:,} bytes.")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise PolicyFileError(origin, 0, f"it is not UTF-8: {error}.") from None


def _opened(path: Path, origin: str) -> int:
    if sys.platform == "win32":  # Windows cannot open a folder
        return os.open(path, os.O_RDONLY | PLAIN)
    folder_fd = os.open(path.parent, os.O_RDONLY)
    try:
        _check_owner(os.fstat(folder_fd), origin, f"its folder {path.parent}")
        return os.open(path.name, os.O_RDONLY | PLAIN | os.O_NONBLOCK, dir_fd=folder_fd)
    finally:
        os.close(folder_fd)


def _check_owner(status: os.stat_result, origin: str, what: str) -> None:
    if others_can_write(status):
        hint = "chmod go-w, for it and its folder."
        raise PolicyFileError(origin, 0, f"{what} can be written by users other than its owner.", hint)
    if is_of_others(status):
        raise PolicyFileError(origin, 0, f"{what} belongs to another user.", "It must be root's, or yours.")


def compiled(documents: Sequence[Document]) -> Rules:
    """Compile the rules of all policies."""
    form = json.dumps([document.form for document in documents], sort_keys=True, allow_nan=False)
    digest = hashlib.sha256(form.encode()).hexdigest()
    return Rules(digest, tuple(document.rules for document in documents))


# ── compiling ──────────────────────────────────────────────────────────────────────────────────────────────────────


def document_of(text: str, origin: str) -> Document:
    """Parse a policy in YAML. Raises `PolicyFileError`."""
    top = parse(text, origin)
    top.require("policy")
    if top.number("policy") != 1:
        raise top.error_at("policy", "this version knows policy: 1 only.")
    name = top.text("name", Path(origin.removeprefix("profile ")).stem)
    zones = {each: _zone(section) for each, section in top.named_sections("zones", "the zone").items()}
    keep_out = keep_out_of(top.section("keep_out"), name)
    document = Document(
        name=name,
        origin=origin,
        about=top.text("about"),
        robot=top.text("robot"),
        mode=top.choice("mode", ("observe", "confirm", "autonomous"), "autonomous"),
        state=_state(top),
        rules=RuleSet(
            name=name,
            allow=tuple(_allowance(section, name, zones) for section in top.sections("allow", "a rule of allow")),
            forbid=tuple(_forbidden(section, name) for section in top.sections("forbid", "a rule of forbid")),
            limits=(
                *(
                    _limit(section, f"{name}: limit {each}", zones)
                    for each, section in top.named_sections("limits", "the limit").items()
                ),
                *limits_of(keep_out),
            ),
            zones=zones,
        ),
        feedback=_feedback(top.section("feedback")),
        pose=_pose(top.section("pose"), zones),
        keep_out=keep_out,
        consent=_consent(top.section("consent")),
        audit=_audit(top.section("audit")),
    )
    top.done()
    return document


def _state(top: Section) -> str:
    """Return the state folder. A relative path is an error: from another working folder it would be another folder,
    without the latch.
    """
    folder = top.text("state")
    if folder and not folder.startswith(("/", "~/")):
        raise top.error_at("state", f"{folder!r} is relative.", "Write the whole path: /var/lib/ros2-mcp.")
    return folder


def _allowance(section: Section, policy: str, zones: dict[str, Zone]) -> Allowance:
    verb, names = _verb(section)
    if verb in _TYPED:
        types = _types(section)
        if not types:
            raise section.error(section.node, f"a rule that allows to {verb} needs 'type'.", 'Any: type: "**"')
    else:
        types = ("**",)
    fields = section.section("fields")
    allowance = Allowance(
        rule=f"{policy} line {section.line}: {verb} {', '.join(names[:3])}{', …' if len(names) > 3 else ''}",
        verb=verb,
        names=names,
        types=types,
        checks=_checks_by_path(fields, zones) if fields else Checks(),
        rate_hz=section.number("rate_hz", low=MIN_RATE_HZ, high=MAX_RATE_HZ)
        if verb in ("publish", "relay", "play")
        else None,
        for_s=section.number("for_s", low=0.0) if verb in ("publish", "relay", "play") else None,
        per_minute=section.number("per_minute", low=0.01),
        consent=section.choice("consent", ("each", "never", ""), ""),
        sole_publisher=verb in ("publish", "relay", "play") and section.flag("sole_publisher"),
        sources=_names(section, "from") if verb == "relay" else (),
        force=verb == "play" and section.flag("force"),
        parameters=section.texts("names") if verb == "set" else (),
        transitions=section.texts("transitions") if verb == "transition" else (),
        meta=verb == "call" and section.flag("meta"),
    )
    for needed, of, found in (
        ("from", "relay", allowance.sources),
        ("names", "set", allowance.parameters),
        ("transitions", "transition", allowance.transitions),
    ):
        if verb == of and not found:
            raise section.error(section.node, f"a rule that allows to {verb} needs {needed!r}.")
    section.done()
    return allowance


def _verb(section: Section) -> tuple[Any, tuple[str, ...]]:
    """Return the verb of a rule, and its names."""
    found = [verb for verb in VERBS if section.has(verb)]
    if len(found) == 1:
        return found[0], _names(section, found[0])
    if found:
        raise section.error_at(found[1], f"one rule is about one verb, not {' and '.join(found)}.")
    nearest = next((hint for key in section.keys if (hint := did_you_mean(key, VERBS))), "")
    hint = nearest or f"Choose from {', '.join(VERBS)}."
    raise section.error(section.node, f"{section.what} needs one of the verbs.", hint)


def _names(section: Section, key: str) -> tuple[str, ...]:
    """Return names or patterns of names, all absolute."""
    found = section.texts(key)
    for name in found:
        if not name.startswith("/") or not _NAME.fullmatch(name):
            if name == "**":
                continue
            hint = "Whole segments: /robot1/cmd_vel, /*/cmd_vel (any one), /**/cmd_vel (any number of them)."
            raise section.error_at(key, f"{name!r} is neither an absolute name nor a pattern.", hint)
    return found


def _types(section: Section) -> tuple[str, ...]:
    """Return full types or patterns of types."""
    if section.has("type") and section.has("types"):
        raise section.error_at("types", "give 'type' or 'types', not both.")
    key = "types" if section.has("types") else "type"
    found = section.texts(key)
    for name in found:
        parts = name.split("/")
        # A type has three parts. A pattern that cannot match one would have no effect, and silently forbid or limit
        # nothing.
        fits = len(parts) - parts.count("**") <= 3 if "**" in parts else len(parts) == 3 and parts[1] in _KINDS
        if name.startswith("/") or not (fits and _NAME.fullmatch(name)):
            hint = (
                "The full name, such as geometry_msgs/msg/Twist, or whole segments: geometry_msgs/msg/*, nav2_msgs/**."
            )
            raise section.error_at(key, f"{name!r} is neither a type nor a pattern of types.", hint)
    return found


def _forbidden(section: Section, policy: str) -> Forbidden:
    verb, names = "", ("**",)
    if any(section.has(verb) for verb in VERBS) or not (section.has("type") or section.has("types")):
        verb, names = _verb(section)
    types = (_types(section) if not verb or verb in _TYPED else ()) or ("**",)
    section.done()
    what = f"{verb} {', '.join(names[:3])}" if verb else ", ".join(types[:3])
    return Forbidden(f"{policy} line {section.line}: forbid {what}", verb, names, types)


def _limit(section: Section, rule: str, zones: dict[str, Zone]) -> Limit:
    section.require("types")
    over = section.section("over")
    ramp = section.section("ramp")
    limit = Limit(
        rule=rule,
        types=_types(section),
        names=_names(section, "names") or ("**",),
        checks=_checks_by_kind(section, zones),
        ramp={path: _ramp(each) for path, each in ramp.each("the ramp of").items()} if ramp else {},
        hold_s=section.number("hold_s", low=0.05, high=60.0),
        tool=over.choice("tool", ("refuse", "clamp"), "refuse") if over else "refuse",
        stream=over.choice("stream", ("clamp", "refuse"), "clamp") if over else "clamp",
    )
    if over:
        over.done()
    section.done()
    if limit.checks.is_empty and not limit.ramp and limit.hold_s is None:
        raise section.error(section.node, f"{section.what} limits nothing.", "Such as norm: {linear: 0.2}.")
    return limit


def _ramp(section: Section) -> Ramp:
    ramp = Ramp(section.number("up", low=0.001), section.number("down", low=0.001))
    section.done()
    return ramp


def _check_path(section: Section, path: str) -> str:
    if path != "" and not _PATH.fullmatch(path):
        raise section.error_at(
            path, f"{path!r} is not the path of a field.", "Such as linear.x or points[].velocities[]."
        )
    return path


def _checks_by_kind(section: Section, zones: dict[str, Zone]) -> Checks:
    """Return the checks of a limit, written as `norm: {linear: 0.2}`: the kind first, paths below it."""

    def below(key: str) -> Section | None:
        found = section.section(key)
        for path in found.all() if found else ():
            _check_path(found, path) if found else None
        return found

    kinds = ("norm", "range", "each", "in", "count", "zone", "pace", "curve")
    norm, ranges, each, one_of, count, zone, pace, curve = map(below, kinds)
    if twice := next((path for path in each.keys if ranges and path in ranges.keys), "") if each else "":
        raise section.error_at("each", f"{twice!r} stands under 'range', too: the two are the same.")
    return Checks(
        norm={path: norm.needed_number(path, 0.0) for path in norm.all()} if norm else {},
        range={path: part.pair(path) for part in (ranges, each) if part for path in part.all()},
        one_of={path: one_of.scalars(path) for path in one_of.all()} if one_of else {},
        zero=section.texts("zero"),
        count={path: _whole(count, path) for path in count.all()} if count else {},
        zone={path: _zone_name(zone, path, zones) for path in zone.all()} if zone else {},
        pace={path: _pace(each) for path, each in pace.each("the pace of").items()} if pace else {},
        curve={path: _curve(each) for path, each in curve.each("the curve of").items()} if curve else {},
    )


def _checks_by_path(fields: Section, zones: dict[str, Zone]) -> Checks:
    """Return the checks of an allowance, written as `fields: {linear: {norm: 0.2}}`: the path first, kinds below it."""
    found: dict[str, dict[str, Any]] = {
        kind: {} for kind in ("norm", "range", "one_of", "count", "zone", "pace", "curve")
    }
    zero: list[str] = []
    for path, section in fields.each("the field").items():
        _check_path(fields, path)
        if section.has("norm"):
            found["norm"][path] = section.needed_number("norm", 0.0)
        if section.has("range"):
            found["range"][path] = section.pair("range")
        if section.has("in") and section.has("is"):
            raise section.error_at("is", "give 'in' or 'is', not both.")
        for key in ("in", "is"):
            if section.has(key):
                found["one_of"][path] = section.scalars(key)
        if section.flag("zero"):
            zero.append(path)
        if section.has("count"):
            found["count"][path] = _whole(section, "count")
        if section.has("zone"):
            found["zone"][path] = _zone_name(section, "zone", zones)
        if pace := section.section("pace"):
            found["pace"][path] = _pace(pace)
        if curve := section.section("curve"):
            found["curve"][path] = _curve(curve)
        section.done()
    return Checks(zero=tuple(zero), keep_out=None, **found)


def _whole(section: Section, key: str) -> tuple[int, int]:
    low, high = section.pair(key)
    if not (low.is_integer() and high.is_integer()):
        raise section.error_at(key, f"{key} must be whole numbers: [fewest, most].")
    return int(low), int(high)


def _zone_name(section: Section, key: str, zones: dict[str, Zone]) -> str:
    name = section.text(key)
    if name not in zones:
        known = f"The zones are {', '.join(zones)}." if zones else "This file has no key 'zones'."
        raise section.error_at(key, f"there is no zone {name!r}.", did_you_mean(name, list(zones), known))
    return name


def _pace(section: Section) -> Pace:
    section.require("most", "first_s")
    pace = Pace(section.needed_number("most", 0.0), section.needed_number("first_s", 0.0))
    section.done()
    return pace


def _curve(section: Section) -> CurveLimits:
    """Return the limits on the whole curve of a trajectory."""
    joints = section.section("joints")
    limits = CurveLimits(
        speed=section.number("speed", low=0.0),
        acceleration=section.number("acceleration", low=0.0),
        step=section.number("step", low=0.0),
        position=section.pair("position") if section.has("position") else None,
        joints={name: _joint(each) for name, each in joints.each("the joint").items()} if joints else {},
        described=not section.has("described") or section.flag("described"),
    )
    section.done()
    is_bounded = limits.joints and all(each.speed is not None for each in limits.joints.values())
    if limits.speed is None and not limits.described and not is_bounded:
        problem = "not every joint has a bound of speed, and the limits of the robot's description are left out."
        raise section.error(section.node, problem, "Give `speed`, in rad/s.")
    return limits


def _joint(section: Section) -> JointBounds:
    low, high = section.pair("position") if section.has("position") else (None, None)
    bounds = JointBounds(low, high, section.number("speed", low=0.0), section.number("acceleration", low=0.0))
    section.done()
    return bounds


def _zone(section: Section) -> Zone:
    corners = polygon(section, "polygon")
    zone = Zone(section.text("frame", "map"), corners, section.needed_number("margin_m", 0.0))
    section.done()
    return zone


def _told_on(section: Section, usual: Feedback | Pose) -> dict[str, str]:
    """Return the topic of the robot's velocity or pose, its type, and the path of the field that is read."""
    section.require("topic")
    (topic, *more), kind = _names(section, "topic"), section.text("type", usual.type)
    if more or "*" in topic:
        raise section.error_at("topic", "the robot reports this on one topic: write its full name, without a pattern.")
    if not _MESSAGE.fullmatch(kind):
        raise section.error_at("type", f"{kind!r} is not a full message type.", f"Such as {usual.type}.")
    path = section.text("path", usual.path)
    if not _PATH.fullmatch(path):
        raise section.error_at("path", f"{path!r} is not the path of a field.", f"Such as {usual.path}.")
    return {"topic": topic, "type": kind, "path": path}


def _speeds(section: Section, key: str) -> Mapping[str, float]:
    """Return speeds by part of a velocity, in m/s and rad/s; empty without the key."""
    found = section.section(key)
    if found is None:
        return {}
    speeds = {part: found.needed_number(part, 0.0) for part in PARTS if found.has(part)}
    found.done()
    return speeds


def _feedback(section: Section | None) -> Feedback | None:
    if section is None:
        return None
    usual = Feedback(topic="")
    feedback = Feedback(
        **_told_on(section, usual),
        still=_speeds(section, "still") or usual.still,
        within_s=section.needed_number("within_s", usual.within_s, low=0.1),
        over=section.needed_number("over", usual.over, low=1.0),
        max_age_s=section.needed_number("max_age_s", usual.max_age_s, low=0.05),
        goals=_speeds(section, "goals"),
    )
    section.done()
    return feedback


def _pose(section: Section | None, zones: dict[str, Zone]) -> Pose | None:
    if section is None:
        return None
    usual = Pose(topic="")
    zone = _zone_name(section, "zone", zones) if section.has("zone") else ""
    frame_id = zones[zone].frame_id if zone else usual.frame_id
    if zone and section.text("frame", frame_id) != frame_id:
        problem = f"the zone {zone!r} is in the frame {frame_id!r}: a place in another frame says nothing of it."
        raise section.error_at("frame", problem, f"Write frame: {frame_id}, or leave it out; or give the zone another.")
    base = section.text("base")
    if base and (section.has("path") or section.has("type")):
        raise section.error_at("base", "with 'base' the topic has transforms: leave out 'type' and 'path'.")
    told = _told_on(section, usual)
    pose = Pose(
        **({**told, "type": TF} if base else told),
        base=base,
        frame_id=section.text("frame", frame_id),
        max_age_s=section.needed_number("max_age_s", usual.max_age_s, low=0.05),
        zone=zone,
        brake_mps2=section.needed_number("brake_mps2", usual.brake_mps2, low=0.01),
        brake_radps2=section.needed_number("brake_radps2", usual.brake_radps2, low=0.01),
    )
    section.done()
    return pose


def _consent(section: Section | None) -> Consent:
    usual = Consent()
    if section is None:
        return usual
    consent = Consent(
        how=section.choice("how", ("operator", "elicitation"), usual.how),
        valid_s=section.needed_number("valid_s", usual.valid_s, low=1.0, high=3600.0),
        grants_s=section.needed_number("grants_s", usual.grants_s, low=0.0, high=86_400.0),
    )
    section.done()
    return consent


def _audit(section: Section | None) -> Auditing:
    usual = Auditing()
    if section is None:
        return usual
    keep_mb = section.number("keep_mb", low=1.0)
    audit = Auditing(
        keep_bytes=None if keep_mb is None else int(keep_mb * 1e6),
        on_failure=section.choice("on_failure", ("refuse", "warn"), usual.on_failure),
    )
    section.done()
    return audit
