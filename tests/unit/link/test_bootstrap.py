"""What is sent to start a bridge on the far side, and what comes back before its stream."""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import subprocess
import sys
import time
import zipfile
import zlib
from pathlib import Path
from typing import cast

import pytest

import ros2_mcp_bridge
from ros2_mcp.link.bootstrap import WORDS, Arrival, bare, bootstrap, packed_bridge
from ros2_mcp_common.start.finding import Search
from ros2_mcp_common.start.stage1 import MARKER

HERE = {"PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/")}
NONCE = "0123456789abcdef"


def line(stage: str, nonce: str = NONCE, **details: str) -> bytes:
    return MARKER + nonce.encode() + b" " + json.dumps({**details, "stage": stage}).encode() + b"\n"


def test_noise_reports_and_the_stream_are_told_apart_wherever_the_pieces_end() -> None:
    sent = b"Welcome!\0\xff\n" + line("reached", python="3.8.10") + b"more\n" + line("bridge") + b"\0\0\0\x02\0\0\0\0{}"
    for size in range(1, len(sent) + 1):
        arrival = Arrival(NONCE)
        stream = b"".join(arrival.feed(sent[start : start + size]) for start in range(0, len(sent), size))
        assert stream == b"\0\0\0\x02\0\0\0\0{}"
        assert arrival.noise == b"Welcome!\0\xff\nmore\n"
        assert [(report.stage, report.details) for report in arrival.reports] == [
            ("reached", {"python": "3.8.10"}),
            ("bridge", {}),
        ]


def test_a_marker_with_another_nonce_is_noise() -> None:
    arrival = Arrival(NONCE)
    assert arrival.feed(line("bridge", "f" * 16) + b"a stream of somebody else's") == b""
    assert not arrival.is_through


def test_noise_without_end_is_given_up() -> None:
    arrival = Arrival(NONCE)
    for _ in range(100):
        arrival.feed(b"y\n" * 1000)
    assert arrival.failure
    assert "more than 64 kB" in arrival.failure.message
    assert len(arrival.noise) < 70_000


def test_what_stage_1_says_of_its_failure_is_one_line_of_bounded_length() -> None:
    arrival = Arrival(NONCE)
    arrival.feed(line("failed", message="No\nROS " + "x" * 5000, hint="Install it."))
    assert arrival.explain(1) is arrival.failure
    assert arrival.failure
    assert arrival.failure.message.startswith("No ROS xxx")
    assert len(arrival.failure.message) <= 600


@pytest.mark.parametrize("broken", [b"[]", b"{", b'{"python": 3}', b"\xff\xfe"])
def test_a_marker_with_what_stage_1_does_not_say_is_a_failure(broken: bytes) -> None:
    arrival = Arrival(NONCE)
    arrival.feed(MARKER + NONCE.encode() + b" " + broken + b"\n")
    assert arrival.failure
    assert not arrival.is_through


@pytest.mark.parametrize(
    ("exit_code", "said", "words"),
    [
        (96, "", "is a terminal"),
        (97, "", "no python3 there"),
        (1, "Error response from daemon: No such container: ros", "no such container"),
        (1, "Error: No such container: ros", "no such container"),
        (1, "Error response from daemon: container 4f is not running", "does not run"),
        (1, "Cannot connect to the Docker daemon at unix:///var/run/docker.sock.", "cannot be reached"),
        (1, "permission denied while trying to connect to the Docker daemon socket", "denies access"),
        (127, 'exec: "sh": executable file not found in $PATH', "cannot execute a shell"),
        (0, "", "ended before the bridge started"),
    ],
)
def test_what_ends_before_the_marker_is_explained(exit_code: int, said: str, words: str) -> None:
    reason = Arrival(NONCE).explain(exit_code, [said])
    assert reason
    assert words in reason.message
    assert reason.hint


def test_an_end_that_only_the_way_in_knows_is_left_to_it() -> None:
    assert Arrival(NONCE).explain(255, ["ssh: connect to host robot port 22: Connection refused"]) is None


def test_both_programs_stand_in_single_quotes_of_every_shell_and_the_whole_is_short() -> None:
    shell, option, script = WORDS
    assert (shell, option) == ("sh", "-c")
    assert script.count("'") == 4
    assert not set("\\!\n") & set(script)
    assert len(script) < 500


def test_stage_1_and_the_whole_bridge_are_sent_and_nothing_else() -> None:
    sent = bootstrap(("ssh", "robot"), Search(distro="jazzy")).pack()
    stage1, head, archive = sent.split(b"\n", 2)
    assert zlib.decompress(base64.b64decode(stage1)).startswith(b'""\n')
    assert json.loads(head)["size"] == len(archive) == len(packed_bridge())
    names = zipfile.ZipFile(io.BytesIO(zlib.decompress(archive))).namelist()
    assert "ros2_mcp_bridge/__main__.py" in names
    assert {Path(name).parts[0] for name in names} == {"ros2_mcp_bridge", "ros2_mcp_common"}


@pytest.mark.parametrize("joins_words", [False, True])
def test_stage_1_answers_whether_the_way_in_executes_words_or_joins_them(joins_words: bool, tmp_path: Path) -> None:
    """Without any ROS: what it says then went all the way. A file of a module's name in the folder does no harm."""
    (tmp_path / "json.py").write_text("raise SystemExit('the wrong json')\n")
    start = bootstrap((), Search(ros_root=str(tmp_path), distro="none"))
    argv = ["sh", "-c", " ".join(start.argv)] if joins_words else start.argv
    done = subprocess.run(
        argv, input=start.pack(), env=HERE, cwd=tmp_path, capture_output=True, timeout=60, check=False
    )
    assert start.arrival.feed(done.stdout) == b""
    assert [report.stage for report in start.arrival.reports] == ["reached"]
    assert start.arrival.failure
    assert "No ROS 2 found there" in start.arrival.failure.message
    assert done.stderr == b""


def test_over_a_slow_link_stage_1_answers_before_the_bridge_is_there_and_while_it_comes(tmp_path: Path) -> None:
    """ssh and the server give up a far side that says nothing."""
    start = bootstrap((), Search(ros_root=str(tmp_path), distro="none"))
    sent, stages = start.pack(), list[str]()
    first, rest = sent[:-60_000], sent[-60_000:]
    pipe = subprocess.PIPE
    with subprocess.Popen(start.argv, stdin=pipe, stdout=pipe, env=HERE, cwd=tmp_path) as process:
        assert process.stdin and process.stdout
        for part in (first, *(rest[place : place + 100] for place in range(0, 1000, 100))):
            process.stdin.write(part)
            process.stdin.flush()
            if part is first:
                start.arrival.feed(process.stdout.readline())
                stages = [report.stage for report in start.arrival.reports]
            time.sleep(0.1)
        start.arrival.feed(process.stdout.readline())
        process.kill()
    assert stages == ["reached"]
    assert [report.stage for report in start.arrival.reports] == ["reached", "receiving"]
    assert 0 < int(start.arrival.reports[1].details["bytes"]) < len(packed_bridge())


def stage_1_where(path: Path, **search: str) -> Arrival:
    """What stage 1 says in a machine with this PATH, without any ROS."""
    start = bootstrap((), Search(ros_root=str(path), distro="none"), container=search.get("container", ""))
    env = {"PATH": str(path), "HOME": str(path)}
    done = subprocess.run(start.argv, input=start.pack(), env=env, capture_output=True, timeout=60, check=False)
    start.arrival.feed(done.stdout)
    return start.arrival


def old_and_new(tmp_path: Path) -> Path:
    """A folder with a `python3` that says that it is 3.7, and this one under the name of its version."""
    (tmp_path / "sh").symlink_to("/bin/sh")
    say = "import sys;sys.version_info=(3,7,16);"
    (tmp_path / "python3").write_text(f'#!/bin/sh\nexec {sys.executable} -ISc "{say}$2"\n')
    (tmp_path / "python3").chmod(0o755)
    (tmp_path / f"python3.{sys.version_info[1]}").symlink_to(sys.executable)
    return tmp_path


def test_a_python_that_is_too_old_hands_over_to_a_newer_one_behind_it(tmp_path: Path) -> None:
    arrival = stage_1_where(old_and_new(tmp_path))
    assert [report.stage for report in arrival.reports] == ["reached"]
    assert arrival.reports[0].details["executable"] == str(tmp_path / f"python3.{sys.version_info[1]}")
    assert arrival.failure
    assert "No ROS 2 found there" in arrival.failure.message


def test_an_engine_that_is_down_is_said_to_be_and_not_the_container(tmp_path: Path) -> None:
    said = "Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is the docker daemon running?"
    (tmp_path / "docker").write_text(f"#!/bin/sh\necho '{said}' >&2; exit 1\n")
    (tmp_path / "docker").chmod(0o755)
    (tmp_path / "python3").symlink_to(sys.executable)
    (tmp_path / "sh").symlink_to("/bin/sh")
    told = stage_1_where(tmp_path, container="ros").failure
    assert told
    assert told.message.startswith("The host is reached, its container engine is not: Cannot connect to the Docker")
    assert told.hint.startswith("Start the engine there")


def test_a_terminal_and_a_machine_without_python_have_their_exit_codes(tmp_path: Path) -> None:
    near, far = os.openpty()
    try:
        ended = subprocess.run(WORDS, stdin=far, env=HERE, timeout=60, check=False).returncode
    finally:
        os.close(near)
        os.close(far)
    explained = Arrival(NONCE).explain(ended)
    assert explained
    assert "terminal" in explained.message


def test_what_is_sent_is_the_same_program_with_the_same_lines() -> None:
    def statements(text: str) -> list[tuple[str, int | None]]:
        tree = ast.parse(text)
        for node in ast.walk(tree):
            for side in ("body", "orelse"):
                parts: list[ast.stmt] | object = getattr(node, side, None)
                if isinstance(parts, list):
                    setattr(node, side, [part for part in cast("list[ast.stmt]", parts) if not is_docstring(part)])
        nodes = [(type(node).__name__, getattr(node, "lineno", None)) for node in ast.walk(tree)]
        return [*nodes, (ast.dump(tree), None)]

    def is_docstring(part: ast.stmt) -> bool:
        return isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant) and isinstance(part.value.value, str)

    for source in Path(ros2_mcp_bridge.__file__).parents[1].glob("ros2_mcp_[bc]*/**/*.py"):
        text = source.read_text("utf-8")
        assert statements(bare(text)) == statements(text), source.name
        assert len(bare(text).splitlines()) == len(text.splitlines()), source.name
    assert len(packed_bridge()) < 130_000  # about a second at 1 Mbit/s, before the first answer


def test_stage_1_is_read_by_a_python_that_is_too_old_and_the_finding_by_the_oldest_that_will_do() -> None:
    sources = Path(__file__).parents[3] / "src" / "ros2_mcp_common" / "start"
    stage1 = (sources / "stage1.py").read_text()
    ast.parse(stage1, feature_version=(3, 6))
    assert "from __future__" not in stage1
    ast.parse((sources / "finding.py").read_text(), feature_version=(3, 8))
