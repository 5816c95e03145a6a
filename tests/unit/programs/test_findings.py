"""What is said of a program before it runs."""

from __future__ import annotations

import pytest

from ros2_mcp.model.errors import BadInput
from ros2_mcp.programs.findings import require_sound
from ros2_mcp.programs.sandbox import Finding


def _told(module: str, member: str) -> str:
    finding = Finding(line=1, rule="unresolved-attribute", message=f"Module `{module}` has no member `{member}`")
    with pytest.raises(BadInput) as raised:
        require_sound([finding], f"{module}.{member}()", ["latest", "publish"])
    return str(raised.value)


def test_a_member_is_missed_in_the_module_that_was_named() -> None:
    assert "latest" in _told("robot", "zzz")
    for module in ("os", "math"):
        assert "latest" not in _told(module, "system")
    assert "It can import robot, math" in _told("os", "system")
