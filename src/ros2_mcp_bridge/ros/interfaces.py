"""Loading the Python classes of interfaces by their names in the graph."""

from __future__ import annotations

import importlib
import re
import sys
from functools import lru_cache
from typing import Any

from ros2_mcp_bridge.request import OperationError

# The topics and services of an action have their own types, which rclpy keeps in Action.Impl.
_PARTS_OF_ACTIONS = {
    "SendGoal": "SendGoalService",
    "GetResult": "GetResultService",
    "FeedbackMessage": "FeedbackMessage",
}

# Only the one proper name is accepted: Python would also find a type by others, which no table of types contains.
_NAME = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)


# More types than a robot has. A class stays loaded anyway, so that evicting one frees nothing.
@lru_cache(maxsize=1024)
def load(type_name: str) -> Any:
    """Return the class of `std_msgs/msg/String`, `nav2_msgs/action/Wait_SendGoal` and the like,
    with its type support loaded.

    Raises:
        OperationError: of kind `unknown_type`, if it cannot be loaded.
    """
    from rclpy.type_support import check_for_type_support  # pyright: ignore[reportUnknownVariableType]

    try:
        if not _NAME.fullmatch(type_name):
            raise ValueError("that is not the name of an interface")
        package, kind, name = type_name.split("/")
        if package not in sys.modules:
            importlib.invalidate_caches()  # it may have been built since this process started
        module = importlib.import_module(f"{package}.{kind}")
        if kind == "action" and "_" in name:
            action, _, part = name.partition("_")
            interface = getattr(getattr(module, action).Impl, _PARTS_OF_ACTIONS[part])
        else:
            interface = getattr(module, name)
        check_for_type_support(interface)
    except Exception as error:  # importing a broken interface package can raise anything
        raise OperationError(
            "unknown_type",
            f"The robot's ROS installation cannot load {type_name}: {error or type(error).__name__}.",
            "Names look like std_msgs/msg/String; the package must be installed and sourced where the bridge runs.",
        ) from error
    return interface
