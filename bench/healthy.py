"""Health checks of the healthy simulated robots: how often a fault is found that is none.

    uv run --extra jazzy python -m bench.healthy --rounds 20

Each round begins a robot and a server, so that what a fresh session finds counts too, and checks twice. Ends with 1 if
any check found anything.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import subprocess
import sys
import time

from mcp.client.session import ClientSession
from mcp.client.stdio import StdioServerParameters, stdio_client

_SETTLES_S = 8.0
"""A robot that has just started is not healthy yet: its nodes wait for each other, and discover each other within 3
s."""
_CHECKS = 2


async def _checked(environment: dict[str, str], interfaces: list[str]) -> list[tuple[str, float]]:
    """Return the text of each check in a fresh session, and the time it took in s."""
    options = [each for folder in interfaces for each in ("--interfaces", folder)]
    command = StdioServerParameters(
        command=sys.executable, args=["-m", "ros2_mcp", "--tools", "all", *options], env=environment
    )
    said: list[tuple[str, float]] = []
    async with stdio_client(command) as (reading, writing), ClientSession(reading, writing) as session:
        await session.initialize()
        for _ in range(_CHECKS):
            begun = time.monotonic()
            answer = await session.call_tool("ros2_health_check", {})
            said.append((answer.content[0].text, time.monotonic() - begun))
    return said


def main() -> int:
    """Print each check that found something, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--robots", nargs="+", default=["rover", "arm", "drone"])
    parser.add_argument("--interfaces", nargs="*", default=[], help="folders of built interface packages")
    arguments = parser.parse_args()
    environment = {"ROS_DOMAIN_ID": "90", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **os.environ}
    found = 0
    for robot in arguments.robots:
        wrong, seconds = 0, list[float]()
        for number in range(arguments.rounds):
            command = [sys.executable, "-m", "ros2_mcp_demo", "--robot", robot, "--until-stdin-closes"]
            with subprocess.Popen(command, stdin=subprocess.PIPE, env=environment) as process:
                time.sleep(_SETTLES_S)
                said = asyncio.run(_checked(environment, arguments.interfaces))
                process.communicate()
            seconds += [took_s for _, took_s in said]
            for text, _ in said:
                if not text.startswith("HEALTHY"):
                    wrong += 1
                    print(f"{robot}, round {number + 1}: {text[:1500]}")
        print(f"{robot}: {wrong} of {len(seconds)} checks found a fault, {sum(seconds) / len(seconds):.1f} s each")
        found += wrong
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
