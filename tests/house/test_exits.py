"""Whatever leaves the bridge leaves by two exits, and each of them asks the limiter first."""

from __future__ import annotations

import ast

import pytest

from support.source import trees

PUBLISHERS, CLIENTS = "src/ros2_mcp_bridge/topics/publishers.py", "src/ros2_mcp_bridge/topics/clients.py"
EXITS = {
    (PUBLISHERS, "publish", "publish_raw"): "self.limits.passing",
    (CLIENTS, "_send", "call_async"): "self._limiter.check_call",
}
"""Where something leaves by which call, and what is asked there before."""
ZEROS = {
    (PUBLISHERS, "publish_zero", "publish_raw"),
    ("src/ros2_mcp_bridge/stopper/stopper.py", "publish_zero", "publish_raw"),
    ("src/ros2_mcp_bridge/stopper/stopper.py", "make", "call_async"),
    ("src/ros2_mcp_bridge/exit/speed_limit.py", "tell", "publish_raw"),
}
"""What can only make a robot stand or slower, and asks nobody: zeros, cancelled goals, Nav2's speed limit."""
SENDING = {"publish_raw", "publish", "call_async", "call", "send_goal", "send_goal_async"}
"""What rclpy's publishers and clients send with."""
OWN = {"publisher.publish", "self.publisher.publish", "self.publish", "relay.publish"}
"""The exit itself and the relay's way to it, as the bridge calls them."""


def sends(path: str, tree: ast.Module) -> list[tuple[str, str, str, ast.FunctionDef]]:
    """Where a call of rclpy's sends something: the path, the function around it, and the call's name."""
    return [
        (path, function.name, node.func.attr, function)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        for node in ast.walk(function)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        if node.func.attr in SENDING and ast.unparse(node.func) not in OWN
        if not any(node in ast.walk(inner) for inner in ast.walk(function) if _is_inner(inner, function))
    ]


def _is_inner(node: ast.AST, function: ast.FunctionDef) -> bool:
    return isinstance(node, ast.FunctionDef) and node is not function


def found() -> list[tuple[str, str, str, ast.FunctionDef]]:
    return [
        one for path, tree in trees().items() if path.startswith("src/ros2_mcp_bridge/") for one in sends(path, tree)
    ]


def test_nothing_leaves_the_bridge_but_by_its_exits() -> None:
    assert {one[:3] for one in found()} == {*EXITS, *ZEROS}
    assert len(found()) == len(EXITS) + len(ZEROS)


@pytest.mark.parametrize("where", EXITS, ids=[name for _, name, _ in EXITS])
def test_an_exit_asks_the_limiter_before_it_sends(where: tuple[str, str, str]) -> None:
    [function] = [function for *place, function in found() if tuple(place) == where]
    calls = {ast.unparse(node.func): node for node in ast.walk(function) if isinstance(node, ast.Call)}
    asking = calls[EXITS[where]]
    [sending] = [node for name, node in calls.items() if name.endswith(where[2])]
    around = [node for node in ast.walk(function) if isinstance(node, ast.With) and asking in ast.walk(node.items[0])]
    assert asking.lineno < sending.lineno
    assert all(sending in ast.walk(block) for block in around)
    asks_at_all = around or [line for line in function.body if isinstance(line, ast.Expr) and line.value is asking]
    assert asks_at_all, "it is asked under a condition"


@pytest.mark.parametrize(
    "planted",
    [
        "def feed(self, data):\n    self._raw.publish_raw(data)",
        "def ask(self, client, message):\n    return client.call_async(message)",
        "def steer(node):\n    node.create_publisher(Twist, '/cmd_vel', 1).publish(Twist())",
    ],
)
def test_another_exit_would_be_found(planted: str) -> None:
    assert sends("src/ros2_mcp_bridge/planted.py", ast.parse(planted))


def test_a_zero_is_made_by_the_bridge_and_takes_nothing_of_others() -> None:
    """Its bytes are serialized from a message that was just made with its defaults."""
    callers = [
        (path, ast.unparse(node))
        for path, tree in trees().items()
        if path.startswith("src/ros2_mcp_bridge/")
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "publish_zero"
    ]
    assert callers == [
        ("src/ros2_mcp_bridge/exit/velocities.py", "publisher.publish_zero(data)"),
        ("src/ros2_mcp_bridge/exit/velocities.py", "publisher.publish_zero(data)"),
        ("src/ros2_mcp_bridge/topics/publishers.py", "self.publish_zero(rcl.serialize(self._interface()))"),
    ]
