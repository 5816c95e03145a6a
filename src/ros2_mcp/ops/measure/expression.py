"""Conditions on messages of the robot's own types; the language is that of `ros2_mcp_common.language.conditions`."""

from __future__ import annotations

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import known_to
from ros2_mcp_common.language import conditions
from ros2_mcp_common.language.conditions import Condition
from ros2_mcp_common.language.paths import PathError

__all__ = ["Condition", "condition"]


def condition(definitions: Definitions, type_name: str, text: str) -> Condition:
    """Parse a condition and check its fields against the type's definition.

    Raises:
        BadInput: if the text is not a condition.
        BadValue: for a field that does not exist, with the nearest existing one.
    """
    try:
        return conditions.condition(known_to(definitions), type_name, text)
    except PathError as error:
        raise BadValue(error.path, error.message, error.hint) from error
    except conditions.ConditionError as error:
        raise BadInput(error.message, error.hint) from error
