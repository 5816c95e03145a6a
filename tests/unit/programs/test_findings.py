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


def test_what_may_be_none_is_no_finding_and_what_is_none_is_one() -> None:
    def finding(found: str) -> Finding:
        message = f"Argument to function `f` is incorrect: Expected `str`, found `{found}`"
        return Finding(line=1, rule="invalid-argument-type", message=message)

    require_sound([finding('None | Literal["a"]'), finding("str | None")], "f(x)", [])
    for wrong in ("None", "Literal[3]", "int | float", "dict[str, Any] | int"):
        with pytest.raises(BadInput, match="line 1"):
            require_sound([finding(wrong)], "f(x)", [])
