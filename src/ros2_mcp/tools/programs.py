"""Tools that run programs."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from ros2_mcp.ops.results import Report
from ros2_mcp.programs.kept import KeptPrograms
from ros2_mcp.programs.run import Ran, run
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import Flag, Number
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import ProgramsHere

PLACE = 66
"""Beside what moves the robot, before `ros2_stop`."""

MAX_RUN_S = 600.0
"""Longer work is not a program that somebody waits for."""


@tool(
    title="Run a program",
    risk="actuate",
    group="programs",
    recorded=True,
    runs_programs=True,
    finds="program, script, Python, loop, calculate, sequence of steps",
)
async def ros2_run(
    robot: Robot,
    report: Report,
    programs: ProgramsHere,
    program: Annotated[str, Field(description="Python; import robot. Or the name of a kept one.")],
    inputs: Annotated[dict[str, Any] | None, Field(description="Names that the program has, with values.")] = None,
    timeout: Annotated[Number, Field(gt=0, le=MAX_RUN_S, description="Ends it after so many seconds.")] = 60.0,
    dry_run: Annotated[Flag, Field(description="Only read, and say what would be done.")] = False,
) -> Ran:
    """Run a Python program in a sandbox in which the robot is the module `robot`. Can move the robot.

    Better than calls where every message counts: loops, conditions, sums over many messages, reactions. For one look
    or one act, call the tool. It may import robot, math, time, json, re, datetime; no files, no network. What
    it prints is the answer. Messages are dicts: m["pose"]["pose"]["position"]["x"]; with fields, m["ranges[0]"];
    besides _topic, _time, _age_s, _dropped. Whatever ends it stops what it moves. No await, no yield.
    """
    code, given = await KeptPrograms(robot.programs_folder).resolve(program, inputs or {})
    return await run(robot, programs, code, given, timeout, report, dry_run=dry_run)
