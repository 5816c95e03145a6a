"""Tools for programs that are kept for next time."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from ros2_mcp.programs.keeping import ProgramList, ProgramRequest, ProgramSaved, list_programs, save_program
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import Flag, Pattern
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import ProgramsHere

PLACE = 121

Inputs = Annotated[
    list[dict[str, Any]] | None,
    Field(
        description='What it takes: [{"name": "distance_m", "type": "number", "description": "How far", "default": 1, '
        '"minimum": 0.1, "maximum": 5}]; also "required", "choices". Types: string, number, integer, boolean, list, '
        "topic, topics, service, node, action, json.",
    ),
]


@tool(
    title="Kept programs",
    risk="read",
    group="programs",
    by_default=False,
    recorded=True,
    finds="kept programs, scripts that exist already",
)
async def ros2_program_list(
    robot: Robot,
    pattern: Pattern = "",
    code: Annotated[Flag, Field(description="Also their code.")] = False,
) -> ProgramList:
    """List the programs that are kept: what each is for, and its inputs. ros2_run runs one by its name."""
    return await list_programs(robot, pattern, with_code=code)


@tool(
    title="Keep a program",
    risk="write",
    group="programs",
    by_default=False,
    finds="keep a program, save a script for later",
)
async def ros2_program_save(
    robot: Robot,
    programs: ProgramsHere,
    name: Annotated[str, Field(description="Such as follow-wall.")],
    program: Annotated[str, Field(description="As it ran with ros2_run; it uses its inputs by name.")] = "",
    description: Annotated[str, Field(description="What it is for, for who finds it in a list.")] = "",
    inputs: Inputs = None,
    replace: Annotated[Flag, Field(description="A new version of one that is kept.")] = False,
    remove: Annotated[Flag, Field(description="Forget it instead.")] = False,
) -> ProgramSaved:
    """Keep a program that has worked, for next time: one short call then, and a prompt for the user. It is checked
    as for a run; nothing runs."""
    request = ProgramRequest(
        name=name, code=program, description=description, inputs=inputs or (), overwrite=replace, remove=remove
    )
    return await save_program(robot, programs, request)
