"""DESIGN: nothing goes in circles, and what runs beside ROS stands alone.

That each floor imports only floors below it is held by the contracts in pyproject.toml (`lint-imports`).
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping, Set
from graphlib import CycleError, TopologicalSorter

import pytest

from support.source import trees

BEYOND_THE_STANDARD_LIBRARY = {
    "ros2_mcp_bridge": {"ros2_mcp_common", "rclpy", "rpyutils"},
    "ros2_mcp_common": set[str](),
}


def module_name(path: str) -> str:
    return path.removeprefix("src/").removesuffix(".py").replace("/", ".").removesuffix(".__init__")


def imported(path: str, tree: ast.Module) -> Iterator[str]:
    """The absolute names that a module imports, wherever in it."""
    package = module_name(path).split(".")
    if not path.endswith("__init__.py"):
        package = package[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package[: len(package) - node.level + 1] if node.level else []
            origin = ".".join([*parts, *([node.module] if node.module else [])])
            yield origin
            yield from (f"{origin}.{alias.name}" for alias in node.names)


def graph() -> Mapping[str, Set[str]]:
    """Which of our modules imports which of our modules."""
    edges = {module_name(path): set(imported(path, tree)) for path, tree in trees().items()}
    return {name: others & edges.keys() - {name} for name, others in edges.items()}


def test_no_modules_import_each_other_in_a_circle() -> None:
    # A package whose __init__ lists its modules is one with them; what counts is that the modules form no circle.
    edges = {name: {other for other in others if not name.startswith(f"{other}.")} for name, others in graph().items()}
    try:
        TopologicalSorter(edges).prepare()
    except CycleError as error:
        pytest.fail(" → ".join(error.args[1]))


@pytest.mark.parametrize("package", BEYOND_THE_STANDARD_LIBRARY)
def test_what_runs_beside_ros_needs_the_standard_library_and_rclpy_only(package: str) -> None:
    allowed = {package, *sys.stdlib_module_names, *BEYOND_THE_STANDARD_LIBRARY[package]}
    foreign = {
        (path, name)
        for path, tree in trees().items()
        if path.startswith(f"src/{package}/")
        for name in imported(path, tree)
        if name.split(".")[0] not in allowed
    }
    assert foreign == set()


@pytest.mark.promise("README", "The server runs under any Python")
def test_the_server_never_imports_rclpy() -> None:
    ours = {path: tree for path, tree in trees().items() if path.startswith("src/ros2_mcp/")}
    assert [path for path, tree in ours.items() if any(n.split(".")[0] == "rclpy" for n in imported(path, tree))] == []
