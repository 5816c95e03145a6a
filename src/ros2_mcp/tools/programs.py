"""Tools that run programs, and keep them for later."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from ros2_mcp.ops.results.results import Report
from ros2_mcp.programs.keeping import ProgramList, ProgramRequest, ProgramSaved, list_programs, save_program
from ros2_mcp.programs.kept import programs_of
from ros2_mcp.programs.run import Ran, run
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import Flag, NamePattern, Number
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import ProgramsHere

PLACE = 66
"""After the tools that move the robot, before `ros2_stop`."""
_KEPT = 121
"""Place of the tools for kept programs: after the tools that everybody needs."""

MAX_RUN_S = 600.0
"""A program that takes longer is not one whose caller waits for it."""

Inputs = Annotated[
    list[dict[str, Any]] | None,
    Field(
        description='Inputs of the program: [{"name": "distance_m", "type": "number", "description": "How far", '
        '"default": 1, "minimum": 0.1, "maximum": 5}]; also "required", "choices". Types: string, number, '
        "integer, boolean, list, topic, topics, service, node, action, json.",
    ),
]


@tool(
    title="Run a program",
    risk="actuate",
    group="programs",
    recorded=True,
    runs_programs=True,
    also_named="ros2_run",
    aliases={"timeout": "timeout_s"},
    finds="program, script, Python, loop, calculate, sequence of steps",
)
async def ros2_program_run(
    robot: Robot,
    session: Session,
    report: Report,
    programs: ProgramsHere,
    program: Annotated[str, Field(description="Python code (import robot), or the name of a kept program.")],
    inputs: Annotated[dict[str, Any] | None, Field(description="Variables for the program: name → value.")] = None,
    timeout_s: Annotated[Number, Field(gt=0, le=MAX_RUN_S, description="Maximum duration in seconds.")] = 60.0,
    dry_run: Annotated[Flag, Field(description="Only read, and report what would be done.")] = False,
) -> Ran:
    """Run a Python program in a sandbox, with the robot as the module `robot`. Can move the robot.

    For work on every message: loops, sums, reactions. For one reading or action, call its tool. The printed text is
    the answer. It can import robot, math, time, json, re and datetime; it has no files, network, NumPy, await or yield.
    Messages are dicts: m["pose"]["pose"]["position"]["x"]; with fields, m["ranges[0]"]; also _topic, _time, _age_s,
    _dropped. Limits: timeout_s, 5 s of computing between two calls, 60 s in all, 64 MB of values. The program's
    end stops what it moves. help() prints all functions, help(robot.drive) one of them.
    """
    code, given = await programs_of(robot).resolve(program, inputs or {})
    return await run(robot, session, programs, code, given, timeout_s, report, dry_run=dry_run)


@tool(
    title="Kept programs",
    risk="read",
    place=_KEPT,
    group="programs",
    by_default=False,
    recorded=True,
    beside={"ros2_program_run": "ros2_program_run runs one by its name."},
    finds="kept programs, scripts that exist already",
)
async def ros2_program_list(
    robot: Robot,
    pattern: NamePattern = "",
    code: Annotated[Flag, Field(description="Also return their code.")] = False,
) -> ProgramList:
    """List the kept programs with their purposes and inputs."""
    return await list_programs(robot, pattern, with_code=code)


@tool(
    title="Save a program",
    risk="write",
    place=_KEPT,
    group="programs",
    by_default=False,
    finds="keep a program, save a script for later",
)
async def ros2_program_save(
    robot: Robot,
    session: Session,
    programs: ProgramsHere,
    name: Annotated[str, Field(description="Such as follow-wall.")],
    program: Annotated[
        str, Field(description="The code as run with ros2_program_run; it uses its inputs by name.")
    ] = "",
    description: Annotated[str, Field(description="Purpose of the program, as lists show it.")] = "",
    inputs: Inputs = None,
    replace: Annotated[Flag, Field(description="Replace the kept program of this name.")] = False,
    remove: Annotated[Flag, Field(description="Delete the program instead.")] = False,
) -> ProgramSaved:
    """Save a program that worked: next time one short call runs it, or the user with an MCP prompt. The code is
    checked, but not run."""
    request = ProgramRequest(
        name=name, code=program, description=description, inputs=inputs or (), overwrite=replace, remove=remove
    )
    return await save_program(robot, session, programs, request)
