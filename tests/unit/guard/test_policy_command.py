"""`ros2-mcp policy`: check, explain, diff and test, which need no robot."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ros2_mcp.cli import run
from ros2_mcp.guard.policy_file import PROFILES

SLOW = PROFILES["teleop-slow"].read_text("utf-8")
HEAD = "verb,name,type,value,rate_hz,duration_s,facts,decision,why\n"
TWIST = "geometry_msgs/msg/Twist"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    tmp_path.chmod(0o755)
    return tmp_path


def written(path: Path, text: str) -> str:
    path.write_text(text, "utf-8")
    path.chmod(0o644)
    return str(path)


def test_check_says_what_a_policy_allows_and_its_digest(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["policy", "check", "teleop-slow"]) == 0
    told = capsys.readouterr().out
    assert "cmd_vel in any namespace: at most 50 Hz; for at most 10 s each time" in told
    assert re.search(r"sha256 [0-9a-f]{64}", told)


def test_check_names_the_line_of_a_mistake_and_the_nearest_right_key(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(folder / "p.yaml", SLOW.replace("rate_hz", "rate_hx"))
    assert run(["policy", "check", path]) == 1
    line = next(number for number, text in enumerate(SLOW.splitlines(), start=1) if "rate_hz" in text)
    told = capsys.readouterr().err
    assert f"line {line}" in told and "rate_hz" in told


@pytest.mark.parametrize(
    ("command", "code", "told"),
    [
        (f'publish /cmd_vel {TWIST} {{"linear": {{"x": 0.1}}}} rate_hz=20 duration_s=5', 0, "ALLOWED"),
        (f'publish /cmd_vel {TWIST} {{"linear": {{"x": 0.5}}}}', 1, "at most 0.2"),
        ('publish cmd_vel geometry_msgs/Twist \'{"linear": {"x": 0.1}}\'', 0, "ALLOWED"),
        ("call /motors std_srvs/srv/Trigger", 1, "REFUSED"),
        ("publsh /cmd_vel", 1, "Did you mean publish?"),
        ("publish", 1, "is not a command"),
        ('publish /cmd_vel {"linear": {"x": 0.1}}', 1, "No type is given"),
        (f'publish /cmd_vel {TWIST} {{"liner": {{"x": 9}}, "linear": {{"x": 0.1}}}}', 0, "not bounded: liner.x ("),
        ('call /a/set_parameters rcl_interfaces/srv/SetParameters {"gain": 1.2}', 1, "no 'gain'. It takes parameters."),
        (f"publish /cmd_vel {TWIST} rate=3", 1, "rate=3"),
        (f"publish /cmd_vel {TWIST} {{x}}", 1, "not JSON"),
    ],
)
def test_explain_says_what_is_decided_and_why(
    command: str, code: int, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["policy", "explain", "teleop-slow", command]) == code
    assert told in "".join(capsys.readouterr())


def test_what_waits_for_a_person_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["policy", "explain", "lab", 'set /lidar {"enabled": false}']) == 0
    assert "A PERSON HAS TO APPROVE" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("value", "code"),
    [("2", 0), ("9", 1)],
)
def test_a_raw_call_is_explained_as_what_it_means(
    value: str, code: int, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(
        folder / "p.yaml", "policy: 1\nallow: [{set: /cam, names: [gain], fields: {gain: {range: [1, 5]}}}]\n"
    )
    entry = f'{{"name": "gain", "value": {{"type": 2, "integer_value": {value}}}}}'
    call = f'call /cam/set_parameters rcl_interfaces/srv/SetParameters {{"parameters": [{entry}]}}'
    assert run(["policy", "explain", path, call]) == code
    assert "set /cam" in capsys.readouterr().out


def test_check_and_explain_say_what_is_watched_with_its_numbers(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    watching = "feedback: {topic: /odom, over: 1.5, goals: {linear: 2}}\npose: {topic: /amcl_pose, max_age_s: 3}\n"
    path = written(folder / "p.yaml", f"{SLOW}\n{watching}")
    assert run(["policy", "check", path]) == 0
    checked = capsys.readouterr().out
    assert run(["policy", "explain", path, f'publish /cmd_vel {TWIST} {{"linear": {{"x": 0.1}}}}']) == 0
    explained = capsys.readouterr().out
    for said in (
        "a velocity drives it faster than 0.3 m/s or 0.75 rad/s, a goal drives it faster than 3 m/s or it is driven",
        "place in the frame map. It is stopped, and the latch set, when it is driven for 3 s without",
    ):
        assert said in checked and said in explained
    assert run(["policy", "check", "teleop-slow"]) == 0
    assert "watched: nothing" in capsys.readouterr().out


def test_diff_names_every_number_that_was_changed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = [match for match in re.finditer(r"(?<=[:\[ ])\d+(\.\d+)?(?=[,}\]\s])", SLOW) if match[0] != "1"]
    assert len(numbers) >= 12
    for number in numbers:
        changed = f"{SLOW[: number.start()]}{float(number[0]) + 7:g}{SLOW[number.end() :]}"
        path = written(folder / "p.yaml", changed)
        assert run(["policy", "diff", "teleop-slow", path]) == 1
        assert f"{float(number[0]) + 7:g}" in capsys.readouterr().out
    assert run(["policy", "diff", "teleop-slow", written(folder / "p.yaml", SLOW)]) == 0


def test_diff_names_what_else_a_policy_says(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(folder / "p.yaml", f"{SLOW}\nfeedback: {{topic: /odom}}\n")
    assert run(["policy", "diff", "teleop-slow", path]) == 1
    assert "/odom" in capsys.readouterr().out


def test_a_table_is_asked_row_by_row(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = (
        f'publish,/cmd_vel,{TWIST},"{{""linear"": {{""x"": 0.1}}}}",,,,allow,\npublish,/cmd_vel,{TWIST},,,,,refuse,no\n'
    )
    table = written(folder / "t.csv", HEAD + rows)
    assert run(["policy", "test", "teleop-slow", table]) == 1
    told = capsys.readouterr().out
    assert f"{table}:3: expected refuse, decided allow" in told and "1 of 2 rows as written" in told


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("publsh,/x,,,,,,allow,", "publish"),
        ("publish,/x,,,,,,maybe,", "maybe"),
        ("publish,/x,,,,,,allow,", "No type is given"),
        (f"publish,/x,{TWIST},{{,,,,allow,", "Column value is not JSON"),
        ("transition,/x,,activate,,,,allow,", "A string needs quotes"),
        (f"publish,/x,{TWIST},,,,7,allow,", "Column facts is not a JSON object"),
        (f"publish,/x,{TWIST},,fast,,,allow,", "Column rate_hz is not a number: 'fast'"),
        (f"publish,/x,{TWIST}", "as many columns"),
    ],
)
def test_a_row_that_is_none_is_named_by_its_line_and_column(
    folder: Path, row: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    table = written(folder / "t.csv", f"{HEAD}{row}\n")
    assert run(["policy", "test", "teleop-slow", table]) == 1
    error = capsys.readouterr().err
    assert f"{table}:2" in error and told in error


def test_the_policy_of_the_how_to_is_in_order_and_decides_as_it_says(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[3] / "docs/how-to/policy.md").read_text("utf-8")
    path = written(folder / "policy.yaml", page.split("```yaml\n")[1].split("```")[0])
    commands = re.findall(r"policy explain policy.yaml '(.*)'", page)
    assert len(commands) == 2
    for command in commands:
        assert run(["policy", "explain", path, command]) == 1, command
        assert "REFUSED" in capsys.readouterr().out
    here = '{"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 3, "y": 3}}}}'
    assert run(["policy", "explain", path, f"goal /navigate_to_pose nav2_msgs/action/NavigateToPose {here}"]) == 0
    assert "A PERSON" in capsys.readouterr().out
