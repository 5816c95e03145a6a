"""Loading the Python classes of interfaces by their names in the graph."""

from __future__ import annotations

import importlib
import keyword
import re
import sys
from functools import lru_cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any

from ros2_mcp_bridge.request import OperationError
from ros2_mcp_bridge.ros import definitions

# The topics and services of an action have their own types, which rclpy keeps in Action.Impl.
_PARTS_OF_ACTIONS = {
    "SendGoal": "SendGoalService",
    "GetResult": "GetResultService",
    "FeedbackMessage": "FeedbackMessage",
}

# Only the one proper name is accepted: Python would also find a type by others, which no table of types contains.
_NAME = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)

_NOT_INSTALLED = "Names look like std_msgs/msg/String; the package must be installed and sourced where the bridge runs."
# As rosidl names the module of `GPSFix2D`: `_gps_fix2_d`.
_CAPITALS = (re.compile("([^_])([A-Z][a-z]+)"), re.compile("([a-z0-9])([A-Z])"))

stood_in: set[str] = set()
"""The types that the middleware knows by a stand-in (`stand_ins.py`): it takes no other for them in this process."""


# More types than a robot has. A class stays loaded anyway, so that evicting one frees nothing.
@lru_cache(maxsize=1024)
def load(type_name: str) -> Any:
    """Return the class of `std_msgs/msg/String`, `nav2_msgs/action/Wait_SendGoal` and the like,
    with its type support loaded.

    Raises:
        OperationError: of kind `unknown_type`, if it cannot be loaded.
    """
    from rclpy.type_support import check_for_type_support  # pyright: ignore[reportUnknownVariableType]

    if type_name in stood_in:
        raise OperationError(
            "unknown_type",
            f"{type_name} was not installed where the bridge runs when its messages were read.",
            "Install its package there, and start this server again.",
        )
    try:
        if not _NAME.fullmatch(type_name):
            raise ValueError("that is not the name of an interface")
        package, kind, name = type_name.split("/")
        if package not in sys.modules:
            importlib.invalidate_caches()  # it may have been built since this began
        module = _module(package, kind)
        if kind == "action" and "_" in name:
            action, _, part = name.partition("_")
            part, _, side = part.partition("_")
            interface = getattr(getattr(module, action).Impl, _PARTS_OF_ACTIONS[part])
            interface = getattr(interface, side) if side else interface
        else:
            interface = getattr(module, name)
        check_for_type_support(interface)
    except SyntaxError as error:
        raise OperationError("unknown_type", *_no_python(type_name, error)) from error
    except Exception as error:  # importing a broken interface package can raise anything
        raise OperationError(
            "unknown_type",
            f"The robot's ROS installation cannot load {type_name}: {error or type(error).__name__}.",
            _NOT_INSTALLED,
        ) from error
    return interface


def _module(package: str, kind: str) -> ModuleType:
    """The module of a package's messages, services or actions.

    Its own code imports them all, so that one whose module is no Python (rosidl makes a field `from` of `from`) spoils
    the others: then each is imported when it is asked for.
    """
    full = f"{package}.{kind}"
    try:
        return importlib.import_module(full)
    except SyntaxError:
        spec = find_spec(full)
        assert spec is not None  # its code has just run
        module = ModuleType(full)
        module.__spec__, module.__path__ = spec, list(spec.submodule_search_locations or ())

        def one(name: str) -> Any:
            if name.startswith("__"):
                raise AttributeError(name) from None
            file = name.partition("_")[0]
            for pattern in _CAPITALS:
                file = pattern.sub(r"\1_\2", file)
            return getattr(importlib.import_module(f"{full}._{file.lower()}"), name)

        module.__dict__["__getattr__"] = one
        sys.modules[full] = module
        setattr(sys.modules[package], kind, module)
        return module


def _no_python(type_name: str, error: SyntaxError) -> tuple[str, str]:
    """Return why a type cannot be loaded if its Python module, or that of a type in it, is not valid Python; and what
    to do.
    """
    for name, field in definitions.fields_below(type_name):
        if keyword.iskeyword(field):
            whose = "its field" if name == type_name else f"in {name} the field"
            return (
                f"rclpy cannot load {type_name}: {whose} {field} is a word of Python.",
                f"Rename the field in the definition and build the package again. The other types of "
                f"{type_name.partition('/')[0]} can be used.",
            )
    return f"rclpy cannot load {type_name}: its module is not valid Python: {error}.", "Build its package again."
