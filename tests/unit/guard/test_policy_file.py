"""The policy file is read strictly: what is wrong names its line and what would be right; nobody else may write it."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest

from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.policy_file import compiled, document_of, read_policies, read_policy
from ros2_mcp.guard.section import PolicyFileError
from ros2_mcp.guard.watch import watch_of
from ros2_mcp_common.policy.feedback import rules_of
from ros2_mcp_common.policy.rules import Ramp, Rules

WHOLE = """\
policy: 1
name: hall-3
about: A base in hall 3.
robot: hall-3-base
mode: confirm
state: /var/lib/ros2-mcp
allow:
  - publish: [/cmd_vel, /*/cmd_vel]
    type: geometry_msgs/msg/Twist
    rate_hz: 50
    for_s: 10
    sole_publisher: true
  - {relay: /cmd_vel, type: geometry_msgs/msg/Twist, from: [/teleop/cmd_vel], for_s: 60}
  - {play: /scan, type: "sensor_msgs/**", force: true}
  - goal: /navigate_to_pose
    type: nav2_msgs/action/NavigateToPose
    consent: each
    fields:
      behavior_tree: {is: ""}
      pose.header.frame_id: {in: [map]}
      pose: {zone: hall}
  - {set: /camera, names: [exposure, gain], fields: {exposure: {range: [1, 500]}}}
  - {transition: /camera, transitions: [activate, deactivate]}
  - {call: /beep, type: std_srvs/srv/Trigger, per_minute: 6, consent: never}
  - {call: "**", type: "**", meta: true, consent: each}
  - {cancel: "/**"}
  - {record: [/odom, /scan]}
forbid:
  - types: ["composition_interfaces/**"]
  - {publish: /joy}
limits:
  base:
    types: [geometry_msgs/msg/Twist, geometry_msgs/msg/TwistStamped]
    norm: {linear: 0.4, angular: 0.8}
    range: {linear.x: [-0.1, 0.4]}
    zero: [linear.y, linear.z]
    ramp: {linear: {up: 0.5, down: 2}, angular: {up: 1.5}}
    over: {tool: refuse, stream: clamp}
    hold_s: 0.5
  arm:
    types: control_msgs/action/FollowJointTrajectory
    each: {"trajectory.points[].velocities[]": [-0.5, 0.5]}
    count: {trajectory.points: [1, 200]}
    pace: {trajectory.points: {most: 0.5, first_s: 5}}
zones: {hall: {frame: map, polygon: [[0, 0], [12, 0], [12, 8], [0, 8]], margin_m: 0.5}}
pose: {topic: /amcl_pose, zone: hall}
feedback: {topic: /odom, still: {linear: 0.03, angular: 0.05}, within_s: 1.0}
consent: {how: elicitation, valid_s: 30, grants_s: 0}
audit: {keep_mb: 10, on_failure: warn}
"""


def test_a_whole_policy_is_read() -> None:
    document = document_of(WHOLE, "hall.yaml")
    assert (document.name, document.robot, document.mode) == ("hall-3", "hall-3-base", "confirm")
    assert [entry.verb for entry in document.rules.allow[:4]] == ["publish", "relay", "play", "goal"]
    publish, limit = document.rules.allow[0], document.rules.limits[0]
    assert (publish.rule, publish.rate_hz, publish.for_s) == ("hall-3 line 8: publish /cmd_vel, /*/cmd_vel", 50, 10)
    assert document.rules.allow[3].checks.one_of == {"behavior_tree": ("",), "pose.header.frame_id": ("map",)}
    assert limit.ramp == {"linear": Ramp(0.5, 2.0), "angular": Ramp(1.5, None)}
    assert document.rules.limits[1].checks.range == {"trajectory.points[].velocities[]": (-0.5, 0.5)}
    assert document.feedback is not None
    assert document.pose is not None
    assert (document.feedback.topic, document.pose.zone) == ("/odom", "hall")
    assert (document.consent.how, document.audit.keep_bytes) == ("elicitation", 10_000_000)


def test_the_rules_are_the_same_after_their_way_to_the_bridge() -> None:
    rules = compiled([document_of(WHOLE, "hall.yaml")])
    assert Rules.from_json(json.loads(json.dumps(rules.as_json()))) == rules


def test_the_digest_is_of_what_is_said_and_not_of_how_it_is_written() -> None:
    said = compiled([document_of(WHOLE, "hall.yaml")]).digest
    assert compiled([document_of("# a comment\n\n" + WHOLE, "other.yaml")]).digest == said
    assert compiled([document_of(WHOLE.replace("0.4, angular", "0.41, angular"), "hall.yaml")]).digest != said
    assert len(said) == 64


SQUARE = "policy: 1\nzones: {square: {frame: odom, polygon: [[0, 0], [1, 0], [1, 1]]}}\n"
KEEP_OUT = "policy: 1\nkeep_out:\n  zones:\n    stairs: [[3, 1], [4, 1], [4, 2]]\n"
WRONG = [
    ("polcy: 1", 1, "needs 'policy'"),
    ("policy: 2", 1, "knows policy: 1 only"),
    ("policy: 1\nlimts: {}", 2, "Did you mean limits"),
    ("policy: 1\nallow: []", 2, "must not be empty. Leave it out"),
    ("policy: 1\nallow:\n  - {publish: /a, type: a/msg/B, consent: always}", 3, "Choose from each, never."),
    ("policy: 1\nzone: {hall: {}}\npose: {topic: /odom, zone: hall}", 3, "This file has no key 'zones'."),
    ("policy: 1\nallow:\n  - {publsh: /a, type: a/msg/B}", 3, "Did you mean publish"),
    ("policy: 1\nallow:\n  - {publish: /a, call: /b, type: a/msg/B}", 3, "one verb"),
    ("policy: 1\nallow:\n  - {publish: /a}", 3, "needs 'type'"),
    ("policy: 1\nallow:\n  - publish: cmd_vel\n    type: a/msg/B", 3, "neither an absolute name"),
    ("policy: 1\nallow:\n  - publish: /cmd_*\n    type: a/msg/B", 3, "Whole segments"),
    ("policy: 1\nallow:\n  - publish: /cmd_vel\n    type: Twist", 4, "neither a type nor a pattern"),
    ("policy: 1\nallow:\n  - publish: /cmd_vel\n    type: a/msg/B\n    rate: 5", 5, "Did you mean rate_hz"),
    ("policy: 1\nallow:\n  - publish: /cmd_vel\n    type: a/msg/B\n    meta: true", 5, "means nothing"),
    ("policy: 1\nallow:\n  - publish: /cmd_vel\n    type: a/msg/B\n    rate_hz: .nan", 5, "must be a number"),
    ("policy: 1\nallow:\n  - publish: /cmd_vel\n    type: a/msg/B\n    rate_hz: '5'", 5, "must be a number"),
    ("policy: 1\nallow:\n  - publish: /cmd_vel\n    type: a/msg/B\n    rate_hz: 0.009", 5, "0.01"),
    ("policy: 1\nallow:\n  - publish: /cmd_vel\n    type: a/msg/B\n    rate_hz: 1001", 5, "1000"),
    ("policy: 1\nallow:\n  - relay: /cmd_vel\n    type: a/msg/B", 3, "needs 'from'"),
    ("policy: 1\nallow:\n  - {set: /camera}", 3, "needs 'names'"),
    ("policy: 1\nlimits:\n  a:\n    norm: {linear: 1}", 4, "needs 'types'"),
    ("policy: 1\nlimits:\n  a:\n    types: a/msg/B\n    norm: {linear: -1}", 5, "must be 0 or more"),
    ("policy: 1\nlimits:\n  a:\n    types: a/msg/B\n    range: {x: [2, 1]}", 5, "more than"),
    ("policy: 1\nlimits:\n  a:\n    types: a/msg/B\n    norm: {linear..x: 1}", 5, "not the path of a field"),
    ("policy: 1\nlimits:\n  a:\n    types: a/msg/B\n    zone: {pose: hal}\nzones: {hall: {polygon: [[0,0],[1,0],[1,1]]}}",  # noqa: E501
     5, "Did you mean hall"),
    ("policy: 1\nmode: confrim", 2, "Did you mean confirm"),
    ("policy: 1\nmode: observe\nmode: autonomous", 3, "there twice"),
    ("policy: 1\nname: &a x\nabout: *a", 2, "anchor"),
    ("policy: 1\nname: [", 2, "not valid YAML"),
    ("- 1", 1, "lines like"),
    ("", 1, "empty"),
    ("policy: 1\nforbid:\n  - {}", 3, "empty"),
    ("policy: 1\nforbid:\n  - {names: /joy}", 3, "needs one of the verbs"),
    ("%YAML 1.1\n---\npolicy: 1\nallow:\n  - {publish: /a, type: a/msg/B, sole_publisher: yes}", 5, "true or false"),
    ("policy: 1\nallow:\n  - publish: /a\n    type: a/msg/B\n    sole_publisher: !!bool on", 5, "true or false."),
    ("policy: 1\nallow:\n  - publish: /a\n    type: a/msg/B\n    fields: {x: {in: [.inf]}}", 5, "in must be a string"),
    (f"policy: 1\nallow:\n  - publish: /a\n    type: a/msg/B\n    for_s: {'9' * 400}", 5, "for_s must be a number"),
    ("policy: 1\nforbid:\n  - types: [nav2_msgs/*]", 3, "'nav2_msgs/*' is neither a type nor a pattern"),
    ("policy: 1\nlimits:\n  a:\n    types: '*'\n    norm: {linear: 1}", 4, "'*' is neither a type nor a pattern"),
    ("policy: 1\nforbid:\n  - types: [a/message/B]", 3, "'a/message/B' is neither a type nor a pattern"),
    ("policy: 1\nforbid:\n  - record: /camera\n    type: sensor_msgs/msg/Image", 4, "'type' means nothing"),
    ("policy: 1\nlimits:\n  a:\n    types: a/msg/B", 4, "limits nothing"),
    ("policy: 1\nlimits:\n  a:\n    types: a/msg/B\n    range: {x: [0, 1]}\n    each: {x: [0, 9]}", 6, "under 'range'"),
    ("policy: 1\nlimits:\n  a:\n    types: a/msg/B\n    count: {x: [0.5, 2]}", 5, "whole numbers"),
    ("policy: 1\nstate: here", 2, "'here' is relative"),
    (f"{SQUARE}pose:\n  topic: /odom\n  zone: square\n  frame: map", 6, "the zone 'square' is in the frame 'odom'"),
    ("policy: 1\npose:\n  topic: /**/odom", 3, "write its full name"),
    ("policy: 1\nfeedback:\n  topic: /odom\n  type: Odometry", 4, "not a full message type"),
    ("policy: 1\nfeedback:\n  topic: /odom\n  path: twist..twist", 4, "not the path of a field"),
    ("policy: 1\nfeedback:\n  topic: /odom\n  still: {liner: 0.1}", 4, "Did you mean linear"),
    ("policy: 1\nfeedback:\n  topic: /odom\n  goals: {speed: 0.1}", 4, "means nothing in goals"),
    ("policy: 1\npose:\n  topic: /tf\n  base: base_link\n  path: pose", 4, "leave out 'type' and 'path'"),
    ("policy: 1\nkeep_out:\n  radius_m: 0.2", 3, "keep_out needs 'zones'"),
    (f"{KEEP_OUT}", 3, "either 'footprint' or 'radius_m'"),
    (f"{KEEP_OUT}  radius_m: 0.2\n  footprint: [[1, 0], [0, 1], [-1, 0]]", 3, "either 'footprint' or 'radius_m'"),
    (f"{KEEP_OUT}  footprint: [[0.2, 0.1], [-0.2, 0.1]]", 5, "three points"),
    (f"{KEEP_OUT}  radius_m: 0", 5, "it must be from 0.01"),
    (f"{KEEP_OUT}  radius_m: 0.2\n  margin_m: 0.01", 6, "must be from 0.05"),
    (f"{KEEP_OUT}  radius_m: 0.2\n  plan: plan", 6, "not the full name of a topic"),
    (f"{KEEP_OUT}  radius_m: 0.2\n  fame: map", 6, "Did you mean frame"),
    ("policy: 1\nkeep_out:\n  zones:\n    a: [[0, 0], [1, 1]]", 4, "three points"),
    ("policy: 1\nkeep_out:\n  zones:\n    a: [[0, 0], [2, 2], [2, 0], [0, 2]]", 4, "[0, 0]–[2, 2] and"),
    ("policy: 1\nkeep_out:\n  zones:\n    a: [[0, 0], [.inf, 1], [1, 1]]", 4, "must be a number"),
    ("policy: 1\nkeep_out:\n  zones:\n    a: [[0, 0], [1, 0], [2, 0]]", 4, "overlap"),
    ("policy: 1\nzones:\n  hall:\n    polygon: [[0, 0], [2, 2], [2, 0], [0, 2]]", 4, "cross"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "line", "said"), WRONG, ids=[said for _, _, said in WRONG])
def test_what_is_wrong_names_its_line_and_what_would_be_right(text: str, line: int, said: str) -> None:
    with pytest.raises(PolicyFileError) as caught:
        document_of(text, "hall.yaml")
    assert caught.value.line == line
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"hall.yaml, line {line}: ")


@pytest.mark.parametrize("frame", ["", ", frame: odom"])
def test_the_place_is_told_in_the_frame_of_its_zone(frame: str) -> None:
    pose = document_of(f"{SQUARE}pose: {{topic: /odom, zone: square{frame}}}", "square.yaml").pose
    assert pose is not None and pose.frame_id == "odom"


def test_two_policies_that_watch_in_different_ways_are_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    paths: list[str] = []
    for number, text in enumerate(
        ("pose: {topic: /a, zone: square}", "pose: {topic: /b, zone: square}", "mode: observe")
    ):
        path = tmp_path / f"{number}.yaml"
        path.write_text(f"{SQUARE}{text}\n")
        path.chmod(0o600)
        paths.append(str(path))
    assert len(read_policies([paths[0], paths[0], paths[2]], tmp_path / "none")) == 3
    with pytest.raises(PolicyFileError, match=r"1\.yaml: the policy 0 has another 'pose', and only one"):
        read_policies(paths, tmp_path / "none")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    tmp_path.chmod(0o700)
    path = tmp_path / "policy.yaml"
    path.write_text(WHOLE)
    path.chmod(0o600)
    return path


def test_a_file_of_our_own_is_read(file: Path) -> None:
    assert read_policy(str(file)).name == "hall-3"


def test_a_file_that_others_may_write_is_refused(file: Path) -> None:
    for mode in (0o620, 0o602):
        file.chmod(mode)
        with pytest.raises(PolicyFileError, match="written by users other than its owner"):
            read_policy(str(file))


def test_a_file_in_a_folder_that_others_may_write_is_refused(file: Path) -> None:
    file.parent.chmod(0o1777)
    with pytest.raises(PolicyFileError, match="its folder"):
        read_policy(str(file))


def test_a_link_a_folder_a_pipe_and_nothing_are_refused(file: Path) -> None:
    link, pipe = file.with_name("link.yaml"), file.with_name("pipe.yaml")
    link.symlink_to(file)
    os.mkfifo(pipe)
    for path, said in ((link, "link"), (pipe, "regular"), (file.parent, "directory"), (file / "no", "read")):
        with pytest.raises(PolicyFileError, match=said):
            read_policy(str(path))


def test_the_policy_of_the_system_holds_besides_what_is_chosen(file: Path) -> None:
    other = file.with_name("other.yaml")
    other.write_text("policy: 1\nname: other\n")
    other.chmod(0o600)
    assert [document.name for document in read_policies([str(other)], file)] == ["hall-3", "other"]
    assert read_policies([], file.with_name("absent.yaml")) == []


def test_an_unknown_profile_names_those_that_there_are() -> None:
    with pytest.raises(PolicyFileError, match="no such profile"):
        read_policy("teleop-slwo")


def test_what_lies_in_the_working_folder_never_stands_for_a_profile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.chmod(0o700)
    (tmp_path / "observe").write_text("policy: 1\nallow: [{call: /**, type: '**', meta: true}]\n")
    (tmp_path / "observe").chmod(0o600)
    monkeypatch.chdir(tmp_path)
    assert read_policy("observe").rules.allow == ()
    assert read_policy("./observe").rules.allow != ()


def test_the_example_of_the_reference_is_a_policy() -> None:
    text = (Path(__file__).parents[3] / "docs/reference/policy-file.md").read_text("utf-8")
    document = document_of(text.partition("```yaml\n")[2].partition("```")[0], "reference")
    assert (document.name, len(document.rules.allow)) == ("hall-3", 5)


PLACED = "pose: {topic: /tf, base: base_link}\n"
WATCHED = f"{PLACED}feedback: {{topic: /odom}}\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"{KEEP_OUT}  radius_m: 0.2\n", "keep_out needs 'pose'"),
        (f"{KEEP_OUT}  radius_m: 0.2\n{PLACED}", "keep_out needs 'feedback'"),
        (f"{KEEP_OUT}  radius_m: 0.2\n  frame: odom\n{WATCHED}", "Write frame: map in both"),
        (f"{KEEP_OUT}  footprint: [[1, 0.3], [-1, 0.3], [-1, -0.3], [1, -0.3]]\n{WATCHED}", "Write margin_m: 0.25."),
    ],
)
def test_zones_that_nothing_would_watch_in_time_are_errors(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(PolicyFileError, match=re.escape(said)):
        read_policies([str(written(tmp_path, text))], tmp_path / "none")


def test_keep_out_zones_reach_the_bridge_as_they_are_written(tmp_path: Path) -> None:
    text = f"{KEEP_OUT}  radius_m: 0.2\n{WATCHED}"
    documents = read_policies([str(written(tmp_path, text))], tmp_path / "none")
    rules = compiled(documents)
    assert Rules.from_json(json.loads(json.dumps(rules.as_json()))) == rules
    _, pose = rules_of(json.loads(json.dumps(watch_of(Policy(documents=documents, rules=rules)))))
    assert pose is not None and list(pose.keep_out) == [documents[0].keep_out]
    assert (pose.base, pose.type, pose.frame_id) == ("base_link", "tf2_msgs/msg/TFMessage", "map")
    goal = rules.policies[0].limits[0]
    assert goal.rule.endswith("line 3: keep_out") and "nav2_msgs/action/NavigateToPose" in goal.types


def written(folder: Path, text: str) -> Path:
    folder.chmod(0o700)
    file = folder / "p.yaml"
    file.write_text(text, "utf-8")
    file.chmod(0o600)
    return file
