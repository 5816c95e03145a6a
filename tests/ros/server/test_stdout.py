"""From the first to the last byte there is nothing but MCP on stdout, and nothing is left behind."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest

from support.agent import FULL, until
from support.raw_server import RawServer, children, lives
from support.standstill import undisturbed

NOISE = """
import atexit, ctypes, os, sys, threading, time

def shout():
    while not {"mcp", "rclpy"} & set(sys.modules):
        time.sleep(0.001)
    c = ctypes.CDLL(None)
    while True:
        print("python says hello", flush=True)
        c.puts(b"c says hello")
        c.fflush(None)
        os.system("echo a child says hello")
        time.sleep(0.02)

threading.Thread(target=shout, daemon=True).start()
atexit.register(print, "python says goodbye")
"""
LOUD = {
    "RCUTILS_LOGGING_USE_STDOUT": "1",
    "RCUTILS_LOGGING_BUFFERED_STREAM": "1",
    "RCUTILS_LOGGING_SEVERITY": "DEBUG",
    "PYTHONVERBOSE": "1",
    "PYTHONDEVMODE": "1",
}


@pytest.mark.parametrize("version", ["2025-11-25", "2026-07-28"] if FULL else ["2026-07-28"])
def test_whatever_prints_stdout_carries_only_protocol_lines(
    start_raw, ros_environment, tmp_path: Path, version: str
) -> None:
    (tmp_path / "sitecustomize.py").write_text(NOISE)
    path = os.pathsep.join([str(tmp_path), ros_environment["PYTHONPATH"]])
    server = start_raw("--log-level", "debug", PYTHONPATH=path, **LOUD)
    server.begin(version)
    server.ask("tools/list")
    # A bridge that tells so much may not be ready in the 20 s that its server waits: then it is asked again.
    until(lambda: not server.call("ros2_topic_list").get("isError"), 60.0)
    assert server.call("ros2_topic_publish", topic_name="not a name", data={})["isError"]
    server.ask("no/such/method")
    server.close()
    lines = server.said.split(b"\n")
    assert lines.pop() == b""
    assert len(lines) >= 5
    assert {json.loads(line)["jsonrpc"] for line in lines} == {"2.0"}
    server.errors.seek(0)
    said_elsewhere = server.errors.read()
    assert b"python says hello" in said_elsewhere
    assert b"c says hello" in said_elsewhere


@pytest.mark.parametrize("ending", ["stdin closes in a call", "SIGTERM", "SIGINT", "SIGKILL"])
def test_server_and_bridge_are_gone_after_the_end_and_wait_for_no_call(start_raw, ending: str) -> None:
    seconds_until_gone(start_raw(), ending)


@pytest.mark.full
@pytest.mark.parametrize("ending", ["stdin closes", "stdin closes in a call", "SIGTERM", "SIGINT", "SIGKILL"])
def test_server_and_bridge_are_gone_within_two_seconds_of_the_end(start_raw, ending: str) -> None:
    assert undisturbed(lambda: seconds_until_gone(start_raw(), ending)) < 2


def seconds_until_gone(server: RawServer, ending: str) -> float:
    """From the end until server and bridge are gone: at most 20 s, and a call that is under way would wait for 60 s."""
    server.begin("2025-11-25")
    status = server.call("ros2_status")
    processes = children(server.process.pid)
    assert processes, status
    if ending == "stdin closes in a call":
        server.send("tools/call", name="ros2_topic_echo_wait", arguments={"topic_name": "/never", "timeout": 60})
        server.call("ros2_status")  # which is begun later
    started = time.monotonic()
    if ending.startswith("stdin"):
        server.close()
    else:
        server.process.send_signal(signal.Signals[ending])
        server.process.wait(20)
    until(lambda: not any(map(lives, processes)), 20)
    took = time.monotonic() - started
    if not ending.startswith("SIGKILL"):
        assert server.process.returncode == 0
    return took
