"""Which policy is in force is said wherever somebody would look, and also that none is."""

from __future__ import annotations

from pathlib import Path

import pytest

from ros2_mcp.commands.doctor import policy_in_force
from ros2_mcp.compose.server import assemble
from ros2_mcp.settings import Settings
from ros2_mcp.tools import TOOLS

SLOW = Settings(policy=("teleop-slow",))


def instructions(settings: Settings) -> str:
    return " ".join(str(assemble(settings).server.instructions).split())


@pytest.mark.promise("README", "ros2_status, doctor and the agent's instructions say that no policy is in force")
def test_without_a_policy_the_instructions_and_doctor_say_so() -> None:
    assert "No policy is in force: nothing but the robot itself limits how fast" in instructions(Settings())
    finding = policy_in_force(Settings())
    assert finding.ok is None and "none is in force" in finding.detail and "policy init" in finding.detail


def test_under_a_policy_the_agent_is_told_to_ask_it_and_doctor_names_it() -> None:
    told = instructions(SLOW)
    assert "ros2_policy shows what is allowed" in told and "No policy" not in told
    finding = policy_in_force(SLOW)
    assert finding.ok and "teleop-slow (profile teleop-slow), mode autonomous, advisory, sha256 " in finding.detail


def test_a_server_that_may_only_read_is_told_nothing_of_acting() -> None:
    assert "olicy is in force" not in instructions(Settings(read_only=True))


def test_doctor_says_what_is_wrong_with_a_policy_and_where(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    path = tmp_path / "p.yaml"
    path.write_text("policy: 1\nallwo: []\n", "utf-8")
    path.chmod(0o644)
    finding = policy_in_force(Settings(policy=(str(path),)))
    assert finding.ok is False and "line 2" in finding.detail and "allow" in finding.fix


@pytest.mark.promise("README", "The agent asks what is allowed with ros2_policy")
@pytest.mark.promise("README", "no tool changes it")
@pytest.mark.promise("ros2_policy", "no tool changes it")
def test_one_tool_is_about_the_policy_and_it_only_reads() -> None:
    about = {tool.name: tool.risk for tool in TOOLS if "policy" in tool.name or "policy" in str(tool.arguments())}
    assert about == {"ros2_policy": "read"}
