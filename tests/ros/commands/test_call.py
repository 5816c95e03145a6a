"""`ros2-mcp call` stays until what it has begun has ended, or until Ctrl+C.

And the server says to a person what it waits for.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from support.agent import Agent
from support.peer_process import Nursery, PeerProcess, reachable
from support.ports import free_port

END_S = 60.0


@pytest.fixture(scope="module")
def field(nursery: Nursery, agent: Agent) -> Iterator[PeerProcess]:
    """The robot that is driven: listens to velocities and counts."""
    peer = reachable(agent, nursery, "watch")
    yield peer
    peer.leave()


def driving(field: PeerProcess) -> list[str]:
    kind = "message_type=geometry_msgs/msg/Twist"
    return ["call", "ros2_topic_publish", f"topic_name={field.name('cmd_vel')}", kind, 'data={"linear": {"x": 0.5}}']


def moves(field: PeerProcess) -> int:
    return sum(speed != 0.0 for _, speed in field.driven())


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + END_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_recording_runs_until_it_is_interrupted(
    ros_environment: dict[str, str], tmp_path: Path, number: signal.Signals
) -> None:
    command = ["--record-dir", str(tmp_path), "call", "ros2_record_start", "topics=/rosout"]
    with begun(ros_environment, *command) as process:
        assert "runs until Ctrl+C ends it" in until(process, "runs until")
        process.send_signal(number)
        said = process.communicate(timeout=END_S)[1]
    assert process.returncode == 0
    bag = Path(said.partition("The bag is ")[2].strip())
    assert " ended as bag recording_" in said and bag.parent == tmp_path and list(bag.glob("*.mcap"))


def test_a_relay_runs_until_its_time_is_over(ros_environment: dict[str, str]) -> None:
    words = ("source_topic=/rosout", "destination_topic=/rosout_again", "duration_sec=3")
    types = ("message_type=rcl_interfaces/msg/Log",)
    with begun(ros_environment, "call", "ros2_relay_start", *words, *types) as process:
        said = process.communicate(timeout=END_S)[1]
    assert process.returncode == 0
    # Of a relay that is over before a busy machine comes to say so, neither is said.
    assert "runs for at most 3 s; Ctrl+C ends it before." in said and "/rosout_again: ended" in said


def test_a_goal_is_followed_to_its_end_with_its_feedback(ros_environment: dict[str, str], robot: PeerProcess) -> None:
    words = (f"action_name={robot.name('count')}", 'goal_fields={"order": 3}')
    with begun(ros_environment, "call", "ros2_send_action_goal", *words) as process:
        answer, said = process.communicate(timeout=END_S)
    assert process.returncode == 0 and ": ACCEPTED." in answer
    assert "is followed until it ends; Ctrl+C cancels it." in said
    assert ": SUCCEEDED." in said and "sequence: [0, 1, 2]" in said


@pytest.mark.promise("stopping", "and its goals are cancelled: it says what became of them")
@pytest.mark.parametrize("waits", ["true", "false"])
def test_ctrl_c_cancels_a_goal_and_says_so(ros_environment: dict[str, str], robot: PeerProcess, waits: str) -> None:
    name = robot.name("count")
    words = (f"action_name={name}", 'goal_fields={"order": 1000}', f"wait_for_result={waits}")
    with begun(ros_environment, "call", "ros2_send_action_goal", *words) as process:
        until(process, "sequence")
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=END_S)[1]
    assert f" of {name}: CANCELED.\n" in said and "Traceback" not in said
    assert process.returncode == 130


@pytest.mark.parametrize("waits", ["true", "false"])
def test_a_goal_that_does_not_succeed_is_a_call_that_failed(
    ros_environment: dict[str, str], robot: PeerProcess, waits: str
) -> None:
    words = (f"action_name={robot.name('abort')}", "goal_fields={}", f"wait_for_result={waits}")
    with begun(ros_environment, "call", "ros2_send_action_goal", *words) as process:
        answer, said = process.communicate(timeout=END_S)
    assert process.returncode == 1 and ": ABORTED." in answer + said


@pytest.mark.promise("stopping", "What another program has begun: ros2-mcp call ros2_stop stops nothing of a server")
@pytest.mark.promise("README", "ros2-mcp call ros2_stop stops nothing of a server or of another call")
@pytest.mark.promise("stopping", "it is never confirmed, and its exit code is 1")
@pytest.mark.promise("stopping", "Ctrl+C ends a call, with its zeros")
@pytest.mark.promise("README", "Ctrl+C ends a call, with a zero on what it drives")
def test_a_call_that_drives_is_ended_by_ctrl_c_with_its_zero_and_not_by_the_stop_of_another_call(
    ros_environment: dict[str, str], field: PeerProcess
) -> None:
    with begun(ros_environment, *driving(field), "frequency=50", "duration=600") as process:  # as long as is needed
        wait_for(lambda: moves(field) > 5)
        with begun(ros_environment, "call", "ros2_stop", "--json") as stop:
            answer, said = stop.communicate(timeout=END_S)
        assert "stops only what it has begun itself" in said and "goes on" in said
        assert not json.loads(answer)["confirmed"] and stop.returncode == 1
        before = moves(field)
        wait_for(lambda: moves(field) > before + 5)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=END_S)[1]
    assert f"{field.name('cmd_vel')}: the call has ended, and a zero command was sent to 1 subscriber.\n" in said
    assert process.returncode == 130 and "Traceback" not in said
    wait_for(lambda: field.driven()[-1][1] == 0.0)  # the field's own thread may take it later than the process ends


def test_one_velocity_is_ended_by_a_zero_with_the_call_and_that_is_said(
    ros_environment: dict[str, str], field: PeerProcess
) -> None:
    before = moves(field)
    with begun(ros_environment, *driving(field)) as process:
        said = process.communicate(timeout=END_S)[1]
    wait_for(lambda: moves(field) > before and field.driven()[-1][1] == 0.0)
    assert (moves(field), process.returncode) == (before + 1, 0)
    assert f"{field.name('cmd_vel')}: the call has ended, and a zero command was sent to 1 subscriber.\n" in said


def test_a_stop_from_a_shell_says_that_it_stops_only_its_own(ros_environment: dict[str, str]) -> None:
    with begun(ros_environment, "call", "ros2_stop") as process:
        printed = process.communicate(timeout=END_S)[0]
    assert "stops only what it has begun itself" in printed and "goes on." in printed
    assert re.search(r"^confirmed +no$", printed, re.MULTILINE) and process.returncode == 1


def test_over_http_the_address_is_said(ros_environment: dict[str, str]) -> None:
    port = free_port()
    with begun(ros_environment, "--transport", "streamable-http", "--port", str(port)) as process:
        assert until(process, "http").strip() == f"ros2-mcp serves MCP at http://127.0.0.1:{port}/mcp"
        process.terminate()
        process.communicate(timeout=END_S)


def test_in_a_terminal_it_says_what_it_waits_for(ros_environment: dict[str, str]) -> None:
    ours, terminal = os.openpty()
    with begun(ros_environment, stdin=terminal) as process:
        assert "waits for an MCP client" in until(process, "ros2-mcp")
        assert "ros2-mcp config claude-code" in until(process, "config")
        process.terminate()
        assert process.communicate(timeout=END_S)[0] == ""
    os.close(ours)
    os.close(terminal)


def begun(environment: dict[str, str], *words: str, stdin: int = subprocess.DEVNULL) -> subprocess.Popen[str]:
    pipes = {"stdin": stdin, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-m", "ros2_mcp", *words], env=environment, text=True, **pipes)


def until(process: subprocess.Popen[str], words: str) -> str:
    """The line of stderr with these words."""
    assert process.stderr
    return next(line for line in process.stderr if words in line)
