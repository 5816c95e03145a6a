"""DESIGN: there is one command path. Nothing outside `robot/` reaches the stream, and one place decides."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from support.source import trees

INSIDE = ("src/ros2_mcp/robot/", "src/ros2_mcp/link/")
MAKES_A_LINK = {
    "src/ros2_mcp/commands/serve.py": {"client.Bridge", "carriers.start_carrier"},
    "src/ros2_mcp/compose/server.py": {"client.Bridge"},
    "src/ros2_mcp/compose/robot.py": {"client.Bridge", "carriers.start_carrier"},
    "src/ros2_mcp/ops/sources/recorded_robot.py": {"client.Bridge"},
}
"""What the composition imports of the stream. The last one makes a link that is never begun, for a recording in the
place of the robot."""
STREAM_MODULES = {"client", "connection", "subscription", "carrier", "carriers", "local", "heartbeat"}
"""Modules of `link/` that carry the stream; the others look for installations."""
EXECUTORS = {"core", "facts", "failsafes", "goals", "publishing", "services", "translation"}
SPEAKING = {"ask", "post", "query", "request", "subscribe"}
OF_MCP = {
    "src/ros2_mcp/resources/push.py": {"self._bus.subscribe"},
    "src/ros2_mcp/mcp/server.py": {"resources.push.subscribe"},
    "src/ros2_mcp/mcp/leases.py": {"context.request"},
    "src/ros2_mcp/mcp/scopes.py": {"context.request"},
}
"""Who is subscribed with, or has made a request, is a client of ours, and no robot."""
FAILSAFES = {"driving", "leave_cancel", "withdraw", "rest"}


def ways_around(path: str, tree: ast.Module) -> Iterator[str]:
    """What in a module outside `robot/` reaches the stream, a fail-safe or an executor by itself."""
    own = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{path}:{node.lineno} imports {name}" for name in _stream_imports(path, node))
        if not isinstance(node, ast.Attribute):
            continue
        is_own = ast.unparse(node.value) == "self" and node.attr in own
        if node.attr in ("bridge", "_bridge"):
            yield f"{path}:{node.lineno} reaches {ast.unparse(node)}"
        elif node.attr in SPEAKING and not is_own and ast.unparse(node) not in OF_MCP.get(path, ()):
            yield f"{path}:{node.lineno} asks {ast.unparse(node)}"
        elif node.attr in FAILSAFES:
            yield f"{path}:{node.lineno} changes {ast.unparse(node)}"


def _stream_imports(path: str, node: ast.ImportFrom) -> Iterator[str]:
    module = node.module or ""
    names = [f"{module}.{alias.name}" for alias in node.names]
    for name in names:
        parts = name.split(".")
        if parts[:2] == ["ros2_mcp", "link"] and STREAM_MODULES & set(parts[2:3]):
            if ".".join(parts[2:]) not in MAKES_A_LINK.get(path, ()):
                yield name
        elif parts[:2] == ["ros2_mcp", "robot"] and EXECUTORS & set(parts[2:3]) and parts[-1][0].islower():
            yield name


def outside() -> Iterator[tuple[str, ast.Module]]:
    for path, tree in trees().items():
        if path.startswith("src/ros2_mcp/") and not path.startswith(INSIDE):
            yield path, tree


def test_nobody_outside_robot_sends_publishes_calls_or_asks_the_bridge() -> None:
    assert [way for path, tree in outside() for way in ways_around(path, tree)] == []


@pytest.mark.parametrize(
    "planted",
    [
        "async def op(robot):\n    await robot.graph.ask('publish', b'', topic='/cmd_vel')",
        "async def op(robot):\n    await robot.graph.query('topics')",
        "def op(robot):\n    robot.graph.post('failsafe_call')",
        "async def op(robot):\n    graph = robot.graph\n    await graph.ask('stop')",
        "async def op(robot):\n    await robot.bridge.request('call', b'', timeout_s=1.0)",
        "async def op(self):\n    send = self._robot.bridge\n    await send.request('call', b'', timeout_s=1.0)",
        "async def op(robot):\n    await robot.bridge.subscribe('/scan', 'a/msg/B', {})",
        "def op(robot):\n    robot.failsafes.withdraw('/cmd_vel')",
        "from ros2_mcp.link.client import Bridge",
        "from ros2_mcp.link import connection",
        "from ros2_mcp.robot.publishing import publish",
        "from ros2_mcp.robot import services",
        "async def op(robot):\n    await robot.bridge.attach()",
        "async def op(events):\n    await events.request('publish')",
        "async def op(robot, shape):\n    await robot.graph.query(shape, 'stop')",
    ],
)
def test_a_way_around_the_command_path_is_found(planted: str) -> None:
    assert list(ways_around("src/ros2_mcp/ops/planted.py", ast.parse(planted)))


def test_what_a_module_calls_its_own_is_no_way_around() -> None:
    own = "class Box:\n    async def ask(self):\n        return await self.ask()\n"
    assert list(ways_around("src/ros2_mcp/ops/planted.py", ast.parse(own))) == []


def test_no_order_on_the_stream_relies_on_the_order_of_tasks() -> None:
    """What has to precede something is posted before it: a task that sleeps for 0 s waits for luck."""
    yielding = [
        f"{path}:{node.lineno}"
        for path, tree in trees().items()
        if path.startswith(INSIDE)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node) in ("asyncio.sleep(0)", "anyio.sleep(0)")
    ]
    assert [place for place in yielding if not place.startswith("src/ros2_mcp/link/child.py:")] == []  # no order there


DECIDING = {("guard", "acting"), ("policy", "decide"), ("policy", "judge")}


def decisions() -> list[str]:
    """Every place that enters the guard, or asks a policy to decide."""
    return [
        f"{path}: {ast.unparse(node.func)}"
        for path, tree in trees().items()
        if path.startswith("src/ros2_mcp/")
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        if any(node.func.attr == verb and ast.unparse(node.func.value).endswith(who) for who, verb in DECIDING)
    ]


def test_one_place_decides() -> None:
    assert set(decisions()) == {
        "src/ros2_mcp/robot/robot.py: self.guard.acting",
        "src/ros2_mcp/guard/guard.py: self.policy.judge",
        "src/ros2_mcp/guard/trials.py: policy.judge",  # about commands that nobody sends
    }


def test_every_command_can_be_carried_out() -> None:
    """A command that is declared without a way to carry it out would fail only when somebody gives it."""
    bases = {
        node.name: [ast.unparse(base).partition("[")[0] for base in node.bases]
        for node in trees()["src/ros2_mcp/model/commands.py"].body
        if isinstance(node, ast.ClassDef)
    }
    abstract = {base for names in bases.values() for base in names}
    declared = {name for name, names in bases.items() if set(names) & abstract & bases.keys()} - abstract
    assert len(declared) >= 11
    table = ast.unparse(trees()["src/ros2_mcp/robot/robot.py"])
    assert {name for name in declared if f"commands.{name}:" not in table} == set()


def test_every_exception_is_still_needed() -> None:
    """What is allowed to the composition and to MCP's own words is what stands there, and no more."""
    used = {
        path: {ast.unparse(node) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        | {
            f"{(node.module or '').removeprefix('ros2_mcp.link.')}.{alias.name}"
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        for path, tree in outside()
    }
    allowed = [(path, name) for table in (MAKES_A_LINK, OF_MCP) for path in table for name in table[path]]
    assert [(path, name) for path, name in allowed if name not in used.get(path, ())] == []
