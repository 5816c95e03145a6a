"""Many clients over HTTP at once, which read pictures, record and drive: memory, disk and the bridge keep their bounds.

Four clients with three calls each here, 32 with 100 in full.
"""

from __future__ import annotations

import json
import random
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest

from support.agent import FULL, until
from support.driver import fresh
from support.observer import Observer, observing
from support.ports import listening
from support.raw_server import children
from support.structured import META as STRUCTURED_META
from support.tokens import BEARER
from support.velocities import TWIST

CLIENTS, CALLS = (32, 100) if FULL else (4, 3)
MEMORY_BYTES = 500_000_000
"""The bar: of server, bridge and stopper together."""
BLACK_BOX_BYTES, RECORDING_BYTES = 60_000_000, 100_000_000
SLACK_BYTES = 5_000_000
"""Of a recording that ends by its size: what was waiting to be written then, and its index."""
PICTURE_BYTES, PICTURES_HZ = 900_000, 15.0
"""A camera of 640 x 480, raw, in colours."""
ANSWER_S = 120.0
"""A call reads for 3 s at most; the rest is 31 others on two processors."""
MODERN = "2026-07-28"
PREFIX = "io.modelcontextprotocol/"
CLIENT = {"name": "one of many", "version": "1"}
META = {f"{PREFIX}protocolVersion": MODERN, f"{PREFIX}clientInfo": CLIENT, f"{PREFIX}clientCapabilities": {}}
SET_BOOL = "std_srvs/srv/SetBool"


@pytest.fixture(scope="module")
def robot(ros_environment: dict[str, str]) -> Iterator[Observer]:
    with observing(ros_environment) as process:
        yield process


class Memory:
    """The most that a process and its children had at once, in bytes; looks every 0.1 s."""

    def __init__(self, pid: int) -> None:
        self.pid, self.most, self.parts = pid, 0, dict[int, int]()
        self._done = threading.Event()

    @contextmanager
    def watched(self) -> Iterator[Memory]:
        watching = threading.Thread(target=self._watch, daemon=True)
        watching.start()
        try:
            yield self
        finally:
            self._done.set()
            watching.join()

    def _watch(self) -> None:
        while not self._done.wait(0.1):
            parts = {pid: _own_bytes(pid) for pid in (self.pid, *children(self.pid))}
            if sum(parts.values()) > self.most:
                self.most, self.parts = sum(parts.values()), parts


def _own_bytes(pid: int) -> int:
    """The memory of a process; what it shares with others counts by its share."""
    try:
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) * 1024
    except (FileNotFoundError, ProcessLookupError):
        pass
    return 0


def ask(port: int, tool: str, **arguments: Any) -> dict[str, Any]:
    """One call of a tool in the modern era: its result, or the HTTP error."""
    params = {"name": tool, "arguments": arguments, "_meta": {**META, **STRUCTURED_META}}
    headers = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json"}
    headers |= {"Authorization": BEARER, "Mcp-Protocol-Version": MODERN, "Mcp-Method": "tools/call", "Mcp-Name": tool}
    with closing(HTTPConnection("127.0.0.1", port, timeout=ANSWER_S)) as connection:
        body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params})
        connection.request("POST", "/mcp", body, headers)
        answer = connection.getresponse()
        text = answer.read().decode()
    if answer.status != 200:
        return {"http": answer.status, "text": text}
    last = text if text.startswith("{") else [line for line in text.splitlines() if line.startswith("data: {")][-1][6:]
    message = json.loads(last)
    return message.get("result") or message


def call_of(dice: random.Random, names: dict[str, str], number: int) -> tuple[str, dict[str, Any]]:
    """Mostly what takes memory; what drives and records is among it."""
    seconds = dice.uniform(0.5, 3.0)
    driving = {"topic_name": f"{names['drive']}_{number}", "message_type": TWIST, "data": {"linear": {"x": 0.1}}}
    return dice.choice(
        (
            ("ros2_topic_subscribe", {"topic_name": names["camera"], "duration": seconds}),
            ("ros2_topic_subscribe", {"topic_name": names["camera"], "duration": seconds, "message_limit": 1000}),
            ("ros2_topic_statistics", {"topic_names": [names["camera"]], "duration_s": seconds}),
            ("ros2_record_start", {"topic_names": [names["camera"]], "max_bytes": RECORDING_BYTES}),
            ("ros2_record_start", {"max_bytes": RECORDING_BYTES}),
            ("ros2_record_status", {}),
            ("ros2_topic_publish", {**driving, "frequency": 20, "duration": seconds}),
            ("ros2_service_call", {"service_name": names["serves"], "fields": {"data": True}}),
            ("ros2_topic_list", {}),
            ("ros2_health_check", {"rate_check_duration_sec": 1}),
        )
    )


def size_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.mark.timeout(1200 if FULL else 120)
def test_many_clients_keep_within_memory_and_disk_and_lose_no_bridge(
    ros_environment: dict[str, str], robot: Observer, tmp_path: Path
) -> None:
    names = {name: fresh(name) for name in ("camera", "serves", "drive")}
    robot.pictures(topic=names["camera"], size=PICTURE_BYTES, hz=PICTURES_HZ)
    robot.serve(service=names["serves"], kind=SET_BOOL)
    box = ("--record-dir", str(tmp_path), "--black-box-bytes", str(BLACK_BOX_BYTES), "--black-box", names["camera"])
    outcomes, failed = Counter[str](), list[str]()

    def client(number: int, port: int) -> None:
        dice = random.Random(number)
        for _ in range(CALLS):
            tool, arguments = call_of(dice, names, number)
            try:
                result = ask(port, tool, **arguments)
            except OSError as error:
                failed.append(f"{tool}: {error!r}")
                continue
            refused = "http" in result or result.get("isError") or "error" in result
            outcomes[f"{tool} {'refused' if refused else 'done'}"] += 1
            if "is started again" in json.dumps(result):
                failed.append(json.dumps(result)[:500])

    with listening(ros_environment, "streamable-http", "--tools", "all", *box) as (port, process):
        until(lambda: names["camera"] in str(ask(port, "ros2_topic_list")), 90.0)  # the first call waits for the bridge
        began = time.monotonic()
        with Memory(process.pid).watched() as memory:
            clients = [threading.Thread(target=client, args=(number, port)) for number in range(CLIENTS)]
            for one in clients:
                one.start()
            for one in clients:
                one.join()
        took_s = time.monotonic() - began
        status = ask(port, "ros2_status")["structuredContent"]
    print(f"{CLIENTS} clients, {CALLS} calls each, in {took_s:.0f} s: {memory.most / 1e6:.0f} MB ({memory.parts})")
    print(dict(outcomes))
    sizes = {folder.name: size_of(folder) for folder in tmp_path.iterdir() if folder.is_dir()}
    print(f"on disk: {sizes}")
    assert failed == []
    assert status["bridge_restarts"] == []
    assert memory.most <= MEMORY_BYTES
    assert any(name.startswith("black-box") for name in sizes) and len(sizes) > 1
    for name, size in sizes.items():
        assert size <= (BLACK_BOX_BYTES if name.startswith("black-box") else RECORDING_BYTES) + SLACK_BYTES, name
