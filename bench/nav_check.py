"""`ros2_nav_check` on the healthy simulated Nav2: what it finds (nothing), its time, and that of the processors.

    PYTHONPATH=tests uv run --extra jazzy --group test python -m bench.nav_check --rounds 30

The robot has about forty topics. Ends with 1 if any check found anything, or took more CPU time than `_MOST_CPU_S`.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import sys
import time

from ros2_mcp.commands.simulation import Graph
from support.demo_robot import build_interfaces, robot_environment, running_robot

from .processes import cpu_seconds
from .stdio import StdioClient

_MOST_CPU_S = 1.5
_SETTLES_S = 10.0


async def _checked(environment: dict[str, str], rounds: int) -> int:
    wrong = 0
    took: list[float] = []
    used: list[float] = []
    command = [sys.executable, "-m", "ros2_mcp", "--tools", "all"]
    async with StdioClient(command, environment) as client:
        await client.initialize()
        await asyncio.sleep(_SETTLES_S)
        status = await client.call("ros2_status")
        topics = (await client.call("ros2_topic_list"))["topics"]
        pids = [client.pid, status["bridge_pid"]]
        for number in range(rounds):
            before, begun = sum(map(cpu_seconds, pids)), time.monotonic()
            answer = await client.call("ros2_nav_check")
            took.append(time.monotonic() - begun)
            used.append(sum(map(cpu_seconds, pids)) - before)
            if answer["verdict"] != "FINE":
                wrong += 1
                print(f"round {number + 1}: {answer['verdict']}: {answer['findings']} {answer['unread']}")
    print(
        f"{wrong} of {rounds} checks found something; {len(topics)} topics; {statistics.median(took):.1f} s "
        f"(at most {max(took):.1f} s) and {statistics.median(used):.2f} s of CPU time (at most {max(used):.2f} s) each"
    )
    return 1 if wrong or statistics.median(used) > _MOST_CPU_S else 0


def main() -> int:
    """Print each check that found something, and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=30)
    arguments = parser.parse_args()
    prefixes, domain_id = build_interfaces("nav2", later=True), Graph.private().domain_id
    with running_robot(prefixes, domain_id, "--robot", "nav2", "--until-stdin-closes"):
        return asyncio.run(_checked(robot_environment(prefixes, ROS_DOMAIN_ID=str(domain_id)), arguments.rounds))


if __name__ == "__main__":
    sys.exit(main())
