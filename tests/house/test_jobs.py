"""Whatever outlives a call is a job that the registry knows: no task is begun beside it, no job is run around it."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from support.source import trees

REGISTRY = "src/ros2_mcp/robot/jobs.py"

BEGINS_TASKS = {
    "ops/watch/changes.py:_follow_goals": "ended in the `finally` of the watch that follows them",
    "ops/actions/send_goal.py:_ending": "the following of feedback, ended in the same function's `finally`",
    "ops/actions/result.py:result_of": "the request for a result, cancelled in the same function's `finally`",
    "ops/actions/send_goal.py:_submit": "the sending of a goal, cancelled in the same function's `finally`",
    "ops/results/results.py:begin": "ended in the `finally` of `reporting`, around it",
    "ops/stop/stop.py:stop_in_reach": "a stop, which ends by itself within seconds and is to outlive its call",
    "ops/space/plans.py:hear": "ended by `close` with the robot; it reads, and moves nothing",
    "ops/sources/newest_samples.py:of": "ended by `close` with the robot; it reads, and moves nothing",
    "ops/navigation/last_costmaps.py:_begun": "ended by `close` with the robot; it reads, and moves nothing",
    "ops/watch/watchers.py:__init__": "a watch ends with the last who listens to it, and moves nothing",
}
"""Operations that begin tasks, and why none of them can outlive what began it unseen."""


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def calls(node: ast.AST) -> Iterator[tuple[str, ast.Call]]:
    """Every call below a node, with the last part of the called name."""
    for call in ast.walk(node):
        if isinstance(call, ast.Call):
            function = call.func
            if isinstance(function, ast.Attribute):
                yield function.attr, call
            elif isinstance(function, ast.Name):
                yield function.id, call


def kinds_of_job() -> dict[str, str]:
    """Every class that is a `Job`, directly or not, with the module that defines it."""
    bases = {
        node.name: ({ast.unparse(base).rpartition(".")[2] for base in node.bases}, path)
        for path, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    kinds = {"Job"}
    while more := {name for name, (parents, _) in bases.items() if parents & kinds} - kinds:
        kinds |= more
    return {name: bases[name][1] for name in kinds - {"Job"}}


def started_in(function: ast.AST) -> set[str]:
    """The classes of which a function gives an object to `jobs.start` or `jobs.run`, made there or named before."""
    made = {
        target.id: names
        for node in ast.walk(function)
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name) and (names := {name for name, _ in calls(node.value)})
    }
    started: set[str] = set()
    for name, call in calls(function):
        if name in ("start", "run") and ast.unparse(call.func).endswith(f"jobs.{name}") and call.args:
            given = call.args[0]
            started |= made.get(given.id, set()) if isinstance(given, ast.Name) else {n for n, _ in calls(given)}
    return started


def begins_a_task(function: ast.AST) -> bool:
    """Whether it does itself, and not a function inside it."""
    for node in ast.iter_child_nodes(function):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("create_task", "ensure_future")):
            return True
        if begins_a_task(node):
            return True
    return False


def test_operations_begin_no_tasks_that_the_registry_does_not_know() -> None:
    begun = {
        f"{path.removeprefix('src/ros2_mcp/')}:{function.name}"
        for path, tree in trees().items()
        if path.startswith("src/ros2_mcp/ops/")
        for function in functions(tree)
        if begins_a_task(function)
    }
    assert begun == set(BEGINS_TASKS), "begin a `Job` with `robot.jobs`, or say here why it cannot outlive the call"


def test_every_kind_of_job_is_started_by_the_registry() -> None:
    started = {name for tree in trees().values() for function in functions(tree) for name in started_in(function)}
    assert {kind: path for kind, path in kinds_of_job().items() if kind not in started} == {}
    assert len(kinds_of_job()) >= 4  # so that it is known that they are found


def test_only_the_registry_runs_a_job() -> None:
    around = [
        f"{path}:{call.lineno}"
        for path, tree in trees().items()
        if path != REGISTRY
        for name, call in calls(tree)
        if name == "_supervise" and "job" in ast.unparse(call.func)
    ]
    assert around == []
