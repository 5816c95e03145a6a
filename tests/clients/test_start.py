"""When a real client's model has our tools."""

from __future__ import annotations

import subprocess

import pytest

from support.clients.client import session
from support.clients.codex import Codex

pytestmark = [pytest.mark.full, pytest.mark.timeout(300)]

ENDS_S = 60.0


def test_codex_has_the_tools_before_the_first_turn_of_its_model(
    ros_environment: dict[str, str], robot: subprocess.Popen[str]
) -> None:
    with session(Codex(), ros_environment, ["Nothing to do."]) as run:
        run.ends(ENDS_S)
        names = {tool["name"] for tool in run.answers("tools/list")[0]["tools"]}
        first = run.model.agent_requests[0]
        assert {name for name in names if not first.tool(name)} == set() < names
