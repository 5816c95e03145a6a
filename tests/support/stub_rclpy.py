"""Imports every module of the bridge beside an rclpy that is nothing but the names of a distribution.

python -m support.stub_rclpy DISTRIBUTION      prints how many modules were imported
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
import types
from pathlib import Path

from support.rclpy_names import COMPILED, names_in

SOURCES = Path(__file__).parents[2] / "src"


class Stub(type):
    """A class of an rclpy that does nothing, with the names it is given."""

    def __call__(cls, *_: object, **__: object) -> object:
        return object.__new__(cls)


def install(distribution: str) -> None:
    """Puts the modules of that rclpy into the place of any other."""
    modules: dict[str, types.ModuleType] = {}
    names = sorted(name for name in names_in(distribution) if "(" not in name)
    for name in names:
        parts = name.split(".")
        # The first part that is a class or a function ends the module's name; the compiled part is one module.
        inside = 2 if name.startswith(COMPILED) else next(at for at in range(1, len(parts)) if _ends(parts, at))
        owner = module(".".join(parts[:inside]), modules)
        for part in parts[inside:]:
            if not hasattr(owner, part):
                setattr(owner, part, Stub(part, (Exception,) if part.endswith("Error") else (), {}))
            owner = getattr(owner, part)
    singleton = module("rclpy.impl.implementation_singleton", modules)
    singleton.rclpy_implementation = modules[COMPILED]


def _ends(parts: list[str], at: int) -> bool:
    modules = {"client", "context", "duration", "executors", "node", "qos", "serialization", "signals", "task"}
    modules |= {"topic_endpoint_info", "endpoint_info", "type_support", "utilities", "experimental", "events_executor"}
    return parts[at] not in modules or at == len(parts) - 1


def module(name: str, modules: dict[str, types.ModuleType]) -> types.ModuleType:
    """The module of that name, made with all above it."""
    if name not in modules:
        made = modules[name] = sys.modules[name] = types.ModuleType(name)
        made.__path__ = []
        above, _, last = name.rpartition(".")
        if above:
            setattr(module(above, modules), last, made)
    return modules[name]


def main() -> None:
    install(sys.argv[1])
    sys.path.insert(0, str(SOURCES))
    import ros2_mcp_bridge

    found = [each.name for each in pkgutil.walk_packages(ros2_mcp_bridge.__path__, "ros2_mcp_bridge.")]
    for name in found:
        importlib.import_module(name)
    print(len(found))


if __name__ == "__main__":
    main()
