"""How many bytes reading the simulated robot costs: text and structured content, without pictures, of each result.

Run it as `python -m bench.sizes [--show TOPIC]`. It starts the simulated robot in a ROS domain of its own, unless
`ROS_DOMAIN_ID` names one in which it runs already. Clients give the model the text, or the structured content, or both.

All 20 reads, as the texts were made of the whole JSON (1150b70) and since they say once what is shared: text 52.6 and
24.3 kB, structured content 51.1 and 40.2 kB, both together 103.7 and 64.5 kB.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from .processes import ENVIRONMENT, ours
from .stdio import STRUCTURED

TOPICS = {
    "/odom": 10,
    "/imu": 10,
    "/scan": 10,
    "/joint_states": 10,
    "/tf": 10,
    "/battery_state": 3,
    "/diagnostics": 3,
    "/pose": 3,
    "/camera/image_raw": 6,
    "/map": 1,
}
"""The main topics, with the number of messages that are read of each: those of a few seconds."""


@contextlib.contextmanager
def robot() -> Iterator[None]:
    """Start the simulated robot unless `ROS_DOMAIN_ID` names one that runs; its first line on stdout says that it is
    ready."""
    if "ROS_DOMAIN_ID" in os.environ:
        yield
        return
    command = [sys.executable, "-m", "ros2_mcp", "demo", "--robot"]
    process = subprocess.Popen(
        command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    try:
        assert any("robot ready" in line for line in process.stdout or ())
        yield
    finally:
        os.killpg(process.pid, signal.SIGINT)
        process.wait(timeout=20)


def sizes(result: dict[str, Any]) -> tuple[int, int]:
    """Return the bytes of the text and of the structured content (written compactly)."""
    text = sum(len(block["text"].encode()) for block in result["content"] if block["type"] == "text")
    return text, len(json.dumps(result["structuredContent"], separators=(",", ":"), ensure_ascii=False).encode())


async def run(shown: str) -> None:
    """Read each topic with the defaults, then several messages of each, and print the bytes."""
    total = 0
    print(f"{'topic':20} {'messages':>8} {'text':>8} {'structured':>10} {'sum':>8}")
    async with ours() as client:
        await client.greet()
        for limited in (False, True):
            whole = 0
            for topic, several in TOPICS.items():
                arguments = {"topic_name": topic, **({"message_limit": several} if limited else {})}
                result = await client.request(
                    "tools/call", name="ros2_topic_subscribe", arguments=arguments, _meta={STRUCTURED: True}
                )
                if topic == shown:
                    print(*(block.get("text", block["type"]) for block in result["content"]), sep="\n")
                text, structured = sizes(result)
                whole += text + structured
                count = result["structuredContent"]["count"]
                print(f"{topic:20} {count:8} {text:8} {structured:10} {text + structured:8}")
            print(f"{'several' if limited else 'defaults':20} {'':8} {'':8} {'':10} {whole:8}\n")
            total += whole
    print(f"all: {total} bytes")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m bench.sizes", description=__doc__)
    parser.add_argument("--show", default="", metavar="TOPIC", help="also print the text of its results")
    with robot():
        asyncio.run(run(parser.parse_args().show))
