"""`ros2-mcp call` for a person: arguments as they are typed, and results as they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import anyio
import pytest
from anyio import to_thread

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.cli import run
from ros2_mcp.commands import call
from ros2_mcp.commands.assignments import read_assignments
from ros2_mcp.commands.operate import servers_in
from ros2_mcp.commands.terminal import readable
from ros2_mcp.compose.server import assemble
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.model.commands import Record
from ros2_mcp.model.errors import BadInput, NotFound, RosNotFound
from ros2_mcp.model.samples import Sample
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.settings import Settings
from support.hostile_bag import write_hostile_bag
from support.made_bridge import MadeBridge
from support.made_windows import encoded
from support.noting_bridge import EVERY, TWIST, Noting

TEXT, NUMBER, YES_OR_NO = {"type": "string"}, {"type": "number"}, {"type": "boolean"}
SCHEMA: dict[str, Any] = {
    "properties": {
        "topic_name": TEXT,
        "limit": {"type": "integer", "default": 20},
        "duration": NUMBER,
        "hidden": YES_OR_NO,
        "topic_names": {"type": "array", "items": TEXT},
        "sizes": {"type": "array", "items": NUMBER},
        "topics": {"type": "array", "items": {"type": "object", "properties": {"name": TEXT}, "required": ["name"]}},
        "data": {"type": "object", "description": 'The fields, such as {"linear": {"x": 0.2}}. Others: default.'},
        "level": {"type": "string", "enum": ["info", "warn"]},
    }
}


def read(*words: str) -> dict[str, Any]:
    return read_assignments(words, SCHEMA, {"old_name": "topic_name"})


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("limit=3", 3),
        ("duration=0.5", 0.5),
        ("duration=2", 2),
        ("hidden=true", True),
        ("topic_name=/scan", "/scan"),
        ('topic_name="/scan"', "/scan"),
        ("topic_name=5", "5"),
        ("topic_names=", []),
        ("topic_names=a[x == \"b, c\"].d,e[1,2],'f,g'", ['a[x == "b, c"].d', "e[1,2]", "'f,g'"]),
        ("topic_names=it's,me", ["it's", "me"]),
        ("topic_name=true", "true"),
        ("topic_name=a=b", "a=b"),
        ("topic_name=", ""),
        ("old_name=/scan", "/scan"),
        ("limit=null", None),
        ('topic_names=["/scan", "/odom"]', ["/scan", "/odom"]),
        ("topic_names=/scan", ["/scan"]),
        ("topic_names=/scan,/odom", ["/scan", "/odom"]),
        ("topic_names=5", ["5"]),
        ("sizes=1,2.5", [1, 2.5]),
        ("topics=/scan", [{"name": "/scan"}]),
        ('topics={"name": "/scan"}', [{"name": "/scan"}]),
        ('data={"linear": {"x": 0.1}}', {"linear": {"x": 0.1}}),
    ],
)
def test_a_word_is_read_as_what_the_argument_is(word: str, value: object) -> None:
    assert list(read(word).values()) == [value]


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("duration=abc", "duration: 'abc' is not a number. Write: duration=2.5"),
        ("limit=2.5", "limit: '2.5' is not a whole number. Write: limit=20"),
        ("hidden=maybe", "hidden: 'maybe' is not true or false. Write: hidden=true"),
        ("data={linear: 1}", """data: '{linear: 1}' is not an object of JSON. Write: 'data={"linear": {"x": 0.2}}'"""),
        ("topic_names=[/scan", """topic_names: '[/scan' is not a list. Write: 'topic_names=["/odom"]'"""),
        ("sizes=1,x", "sizes: 'x' is not a number"),
        ("topics=[{", """Write: 'topics=[{"name": "text"}]'"""),
        ("topic=/scan", "It has no argument 'topic'. Did you mean topic_name?"),
        ("scan", "'scan' is not an assignment. Write argument=value, such as topic_name=/odom."),
    ],
)
def test_what_cannot_be_read_is_shown_as_it_is_to_be_written(word: str, told: str) -> None:
    with pytest.raises(BadInput) as refused:
        read(word)
    assert told in str(refused.value)


@pytest.mark.parametrize("second", ["topic_name=/b", "old_name=/b"])
def test_an_argument_that_is_given_twice_is_refused(second: str) -> None:
    with pytest.raises(BadInput, match="are one argument, which is given twice"):
        read("topic_name=/a", second)


def test_a_missing_argument_is_shown_with_an_example() -> None:
    with pytest.raises(BadInput, match=r"needs the argument 'topic_name', 'level'. Write: topic_name=/odom level=info"):
        read_assignments([], {**SCHEMA, "required": ["topic_name", "level"]}, {})


def lines(result: dict[str, Any], *summary: str, width: int = 80) -> list[str]:
    return readable(summary, result, width)


def test_a_list_of_things_is_a_table_without_what_is_empty() -> None:
    rows = [{"topic_name": "/odom", "publishers": 1, "note": ""}, {"topic_name": "/tf", "publishers": 12, "note": ""}]
    assert lines({"topics": rows, "total": 2}, "2 topics.") == [
        "2 topics.",
        "",
        "topic name  publishers",
        "/odom                1",
        "/tf                 12",
    ]


def test_names_have_their_units_and_numbers_few_digits() -> None:
    assert lines({"rates": [{"rate_hz": 10.00942, "age_max_s": 0.0094827}]}) == [
        "",
        "rate [Hz]  age max [s]",
        "    10.01     0.009483",
    ]
    assert lines({"uptime_s": 5.178, "memory_bytes": 78_229_504}) == ["", "uptime  5.178 s", "memory  78.2 MB"]


def test_few_things_with_many_facts_stand_side_by_side() -> None:
    rows = [{"topic_name": name, **{f"long_fact_{at}": at for at in range(9)}} for name in ("/a", "/b")]
    shown = lines({"topics": rows}, width=40)
    assert shown[1].split() == ["topic", "name", "/a", "/b"] and shown[-1].split() == ["long", "fact", "8", "8", "8"]


def test_a_table_fits_the_terminal_and_says_what_is_left_out() -> None:
    row = {"name": "/a", "type": "sensor_msgs/msg/CompressedImage", "words": "some words " * 9, "one": 1, "two": 2}
    shown = lines({"rows": [row]}, width=50)
    assert all(len(line) <= 50 for line in shown) and "…" in shown[2]
    narrow = lines({"rows": [row]}, width=30)
    assert narrow[-1] == "(and words, one, two: --json has all)"


def test_a_message_is_shown_much_as_ros2_topic_echo_does() -> None:
    header = {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "odom"}
    message = {"header": header, "on": False, "covariance": [0.0] * 8 + [1e6], "data": [], "name": "", "big": "x" * 90}
    assert lines({"message": message, "waited": 0.5}, width=40) == [
        "",
        "header:",
        "  stamp: 12.000000034",
        "  frame_id: odom",
        "on: false",
        "covariance:",
        "        0        0        0",
        "        0        0        0",
        "        0        0  1000000",
        "data: []",
        "name: ''",
        f"big: {'x' * 90}",
        "",
        "waited 0.5 s",
    ]


def test_several_small_messages_are_a_table_with_their_times() -> None:
    times = ["2026-11-22T06:15:11.630370Z", "2026-11-22T06:15:12.677297Z"]
    messages = [{"position": {"x": 1.25, "y": 50.0614321}}, {"position": {"x": 2.0, "y": 0.0}}]
    assert lines({"messages": messages, "received_at": times, "truncated": []}) == [
        "",
        "received_at   position.x  position.y",
        "06:15:11.630        1.25  50.0614321",
        "06:15:12.677           2           0",
    ]


def test_a_long_array_shows_its_bounds_and_its_beginning() -> None:
    ranges = {"$summary": "float32[]", "length": 360, "min": 0.5, "max": 4.0, "first": [float(at) for at in range(64)]}
    assert lines({"message": {"ranges": ranges}}) == [
        "",
        "ranges: float32[360], min 0.5, max 4, begins 0, 1, 2, 3, 4, 5, …",
    ]


def test_a_covariance_of_which_only_the_diagonal_is_given_says_so() -> None:
    assert lines({"message": {"covariance": {"$diagonal": [1.0, 0.5]}}}) == ["", "covariance: diagonal [1, 0.5]"]


def test_what_the_summary_says_is_not_said_again() -> None:
    found = [{"subject": "/scan", "problem": "It is silent.", "severity": "critical"}]
    result = {"topic_name": "/scan", "findings": found, "verdict": "CRITICAL", "note": "Look."}
    assert lines(result, "CRITICAL.", "critical: /scan: It is silent. Look.") == [
        "CRITICAL.",
        "critical: /scan: It is silent. Look.",
    ]


def test_a_line_break_of_the_robot_begins_no_line() -> None:
    hostile = {"data": "a\nb", "c\nd": {"e\nf": 1}}
    assert lines({"message": hostile}) == ["", "data: a\\nb", "c\\nd: {e\\nf: 1}"]
    assert not any("\n" in line for line in lines({"values": hostile, "rows": [hostile, hostile]}))


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with a few numbers on /count."""
    folder = tmp_path_factory.mktemp("call") / "run"
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    writer.add_topic(StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n"))
    for number in range(3):
        data = encoded("std_msgs/msg/Int32", {"data": number})
        writer.write("/count", Sample(1_700_000_000_000_000_000 + number * 10**9, 0, number, data))
    writer.close()
    return folder


ASKS = """
policy: 1
robot: hall
state: {folder}
mode: confirm
allow:
  - {{record: "/**"}}
"""


@pytest.mark.parametrize(("answer", "outcome"), [("approve", "recorded"), ("deny", "The operator denied this call")])
async def test_a_call_that_a_person_has_to_approve_waits_for_the_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], answer: str, outcome: str
) -> None:
    async def start(robot: Robot, session: Session, *_: Any) -> Any:
        await robot.do(Record(principal=session.principal, name="run", topics=()), session)
        raise RosNotFound("It is recorded.")  # it needs no robot to be decided about

    def operated() -> str:
        [server] = servers_in(tmp_path / "hall")
        [request] = server.do("list")["waiting"]
        server.do(answer, id=request["id"])
        server.close()
        return request["id"]

    async def operating() -> str:
        while True:
            try:
                return await to_thread.run_sync(operated)
            except NotFound:
                await anyio.sleep(0.02)

    monkeypatch.setattr("ros2_mcp.ops.memory.record.start", start)
    file = tmp_path / "policy.yaml"
    file.write_text(ASKS.format(folder=tmp_path))
    file.chmod(0o600)
    settings = Settings(policy=(str(file),), tools=("all",), record_dir=tmp_path)
    assembly = assemble(settings, MadeBridge())
    asked: list[str] = []
    async with assembly.running(), anyio.create_task_group() as group:

        async def operate() -> None:
            asked.append(await operating())

        group.start_soon(operate)
        with pytest.raises(CallFailed, match=outcome):
            await call.approved(settings, assembly.toolset.by_name["ros2_record_start"], {"name": "run"})
    assert f"{asked[0]} waits for a person: ros2-mcp operate" in capsys.readouterr().err


def test_a_call_prints_a_table_and_takes_one_name_for_a_list(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--bag", str(bag), "call", "ros2_topic_list"]) == 0
    printed = capsys.readouterr().out
    assert "{" not in printed and "/count      std_msgs/msg/Int32" in printed
    assert run(["--bag", str(bag), "call", "ros2_topic_stats", "topic_names=/count"]) == 0
    assert "/count" in capsys.readouterr().out


def test_an_argument_that_cannot_be_read_ends_with_one_line(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--bag", str(bag), "call", "ros2_topic_subscribe", "topic_name=/count", "message_limit=x"]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert printed.err.startswith("ros2-mcp: message_limit: 'x' is not a whole number. Write: message_limit=")


def test_a_picture_is_saved_and_its_file_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_hostile_bag(tmp_path / "pictures")
    assert run(["--bag", str(bag), "call", "ros2_topic_subscribe", "topic_name=/jpeg"]) == 0
    before_the_message = capsys.readouterr().out.partition("\n\n")[0]
    [line] = [line for line in before_the_message.splitlines() if line.startswith("picture saved: ")]
    saved = Path(line.removeprefix("picture saved: "))
    assert saved.stat().st_size > 0
    saved.unlink()


@pytest.mark.parametrize("words", [("--output", "{folder}"), ("--output={folder}",)])
def test_a_picture_is_saved_to_the_folder_that_is_asked_for(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, folder = write_hostile_bag(tmp_path / "pictures"), tmp_path / "new" / "folder"
    output = [word.format(folder=folder) for word in words]
    assert run(["--bag", str(bag), "call", "ros2_topic_subscribe", "--json", *output, "topic_name=/jpeg"]) == 0
    [saved] = folder.iterdir()
    printed = capsys.readouterr()
    assert printed.out.count("\n") == 1 and printed.err == f"picture saved: {saved}\n"


@pytest.mark.parametrize("words", [("--help", "ros2_topic_publish"), ("ros2_topic_publish", "data=x", "-h")])
def test_the_help_on_a_tool_has_its_arguments_and_an_example(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["call", *words]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("ros2_topic_publish (can move the robot)\n\nPublish a message once")
    assert "\n  topic_name  (text, needed)\n      Such as /cmd_vel" in printed
    example = """ros2-mcp call ros2_topic_publish topic_name=/cmd_vel 'data={"linear": {"x": 0.2}}'\n"""
    assert printed.endswith(f"For example: {example}")


def test_help_without_a_tool_is_that_of_call_and_on_an_unknown_one_names_the_nearest(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["call", "--help"])
    assert ended.value.code == 0 and "--output DIR" in capsys.readouterr().out
    assert run(["call", "ros2_topic_lst", "--help"]) == 1
    assert "Did you mean ros2_topic_list?" in capsys.readouterr().err


def test_the_list_of_tools_tells_which_a_client_is_offered(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["call"]) == 0
    usual, _, others = capsys.readouterr().out.partition("What a client is offered with")
    assert usual.startswith("What a client is offered by default:\n") and "  ros2_topic_list " in usual
    assert "--tools default,pictures" in others and "  ros2_plot " in others and "ros2_plot" not in usual
    assert "ros2-mcp call TOOL --help" in others


async def test_the_end_of_a_call_sends_its_zero_and_is_no_stop(
    robot: Robot, bridge: Noting, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stop is an event of its own: under a policy it latches, and the next call could not act any more."""
    await robot.do(EVERY[0])
    bridge.zeros = [{"topic": "/cmd_vel", "type": TWIST, "matched": 2, "acked": True}]
    await call._stop(robot)  # pyright: ignore[reportPrivateUsage] - the rest of a call needs a terminal
    assert (bridge.sent.count("zero"), bridge.sent.count("stop"), robot.stops.epoch) == (1, 0, 0)
    assert capsys.readouterr().err == "/cmd_vel: the call has ended, and a zero command was sent to 2 subscribers.\n"


@pytest.mark.parametrize(("acknowledged", "told"), [(False, "NOT confirmed: not every one"), (None, "NOT confirmed")])
async def test_the_end_of_a_call_says_where_its_zero_may_not_have_arrived(
    robot: Robot, bridge: Noting, capsys: pytest.CaptureFixture[str], acknowledged: bool | None, told: str
) -> None:
    await robot.do(EVERY[0])
    bridge.zeros = [{"topic": "/cmd_vel", "type": TWIST, "matched": 2, "acked": acknowledged}]
    await call._stop(robot)  # pyright: ignore[reportPrivateUsage]
    assert told in capsys.readouterr().err


async def test_a_call_that_drove_nothing_sends_no_zero(robot: Robot, bridge: Noting) -> None:
    await call._stop(robot)  # pyright: ignore[reportPrivateUsage]
    assert bridge.sent == []
