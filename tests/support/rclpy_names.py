"""The public names of rclpy: those that a version has, and those that the bridge uses.

    python -m support.rclpy_names FOLDER      prints the names of an rclpy: its sources (`rclpy/rclpy`), or as installed

What a distribution has is in `tests/support/rclpy/<distribution>.txt`: names alone, read in its public branch or in its
wheels, of the modules, classes and functions that the bridge uses. A name is `rclpy.node.Node.get_name`, with a
parameter `rclpy.create_node(enable_rosout)`; the compiled part is called `rclpy.impl`, wherever a version keeps it.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

from support.source import trees

DISTRIBUTIONS = ("humble", "jazzy", "kilted", "lyrical")
COMPILED = "rclpy.impl"
_LISTS = Path(__file__).parent / "rclpy"
# The modules of which a list has the names: all that the bridge uses.
_MODULES = (
    *("client", "context", "duration", "executors", "experimental.events_executor", "node", "qos", "serialization"),
    *("signals", "task", "topic_endpoint_info", "endpoint_info", "type_support", "utilities", ""),
)
_CPP_CLASS = re.compile(r'(?:py|nb)::(?:class|enum)_<\s*(?P<base>[^(]*)>\s*\(\s*\w+,\s*"(?P<name>\w+)"')
_CPP_NAME = re.compile(
    r'(?P<on>m|module)?\s*\.(?:value|def(?:_property_readonly|_readonly|_static|_rw|_ro)?)\(\s*"(?P<name>\w+)"'
)
_CPP_ERROR = re.compile(r'exception<[^>]*>\(\s*m,\s*"(?P<name>\w+)"')

# What the bridge calls things of rclpy, everywhere.
_CALLED: Mapping[str, str] = {
    "client": "rclpy.client.Client",
    "context": "rclpy.context.Context",
    "duration": "rclpy.duration.Duration",
    "executor": "rclpy.executors.Executor",
    "future": "rclpy.task.Future",
    "handle": f"{COMPILED}.Node",
    "info": "rclpy.topic_endpoint_info.TopicEndpointInfo",
    "node": "rclpy.node.Node",
    "offered": "rclpy.qos.QoSProfile",
    "profile": "rclpy.qos.QoSProfile",
    "profile_found": "rclpy.qos.QoSProfile",
    "qos_profile": "rclpy.qos.QoSProfile",
    "requested": "rclpy.qos.QoSProfile",
    "rclpy_implementation": COMPILED,
}
# Of the package as of any, and of a dictionary that is called like something of rclpy.
_NOT_OF_RCLPY = ("rclpy.__file__", ".TopicEndpointInfo.get")
_PROTOCOLS = {"RawPublisher": f"{COMPILED}.Publisher", "RawSubscription": f"{COMPILED}.Subscription"}


def names_in(distribution: str) -> frozenset[str]:
    """The names that a distribution has."""
    lines = (_LISTS / f"{distribution}.txt").read_text("utf-8").splitlines()
    return frozenset(line for line in lines if line and not line.startswith("#"))


# ── what the bridge uses ─────────────────────────────────────────────────────────────────────────────────────────────


@cache
def used() -> Mapping[str, str]:
    """Every name of rclpy that the bridge uses, with the first place where it does; typing alone does not count."""
    found: dict[str, str] = {}
    for path, tree in sorted(trees().items()):
        if path.startswith("src/ros2_mcp_bridge/"):
            for name, line in _used_in(tree):
                if not name.endswith(_NOT_OF_RCLPY):
                    found.setdefault(name, f"{path}:{line}")
    return found


def is_in(name: str, distribution: str) -> bool:
    """Whether a distribution has the name; what a class takes as any keyword is one of its members."""
    have = names_in(distribution)
    owner, _, keyword = name.rstrip(")").partition("(")
    return name in have or (bool(keyword) and f"{owner}(**)" in have and f"{owner}.{keyword}" in have)


def _used_in(tree: ast.Module) -> Iterator[tuple[str, int]]:
    imported: dict[str, str] = {}
    optional = {id(node) for block in ast.walk(tree) if _is_optional(block) for node in ast.walk(block)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "rclpy":
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if alias.name not in _CALLED:
                    imported[alias.asname or alias.name] = name
                    if id(node) not in optional:
                        yield name, node.lineno
        elif isinstance(node, ast.Import) and any(alias.name == "rclpy" for alias in node.names):
            imported["rclpy"] = "rclpy"
        elif isinstance(node, ast.ClassDef) and (compiled := _PROTOCOLS.get(node.name)) and _is_protocol(node):
            yield from ((f"{compiled}.{each.name}", each.lineno) for each in _functions(node))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and _has_names(owner := _owner(node.value, imported)):
            yield f"{owner}.{node.attr}", node.lineno
        elif isinstance(node, ast.Call) and (called := _called(node.func, imported)):
            yield from ((f"{called}({keyword.arg})", node.lineno) for keyword in node.keywords if keyword.arg)


def _owner(node: ast.expr, imported: Mapping[str, str]) -> str:
    """The full name of what an expression is, "" where it is nothing of rclpy."""
    if isinstance(node, ast.Name):
        return imported.get(node.id) or _CALLED.get(node.id.lstrip("_"), "")
    if isinstance(node, ast.Attribute):
        if node.attr.lstrip("_") in _CALLED:
            return _CALLED[node.attr.lstrip("_")]
        owner = _owner(node.value, imported)
        return f"{owner}.{node.attr}" if owner else ""
    return _called(node.func, imported) if isinstance(node, ast.Call) else ""


def _called(node: ast.expr, imported: Mapping[str, str]) -> str:
    """The full name of what is called: a function or class that was imported, or of a module or a class."""
    if isinstance(node, ast.Attribute):
        owner = _owner(node.value, imported)
        return f"{owner}.{node.attr}" if _has_names(owner) else ""
    return imported.get(node.id, "") if isinstance(node, ast.Name) else ""


def _has_names(owner: str) -> bool:
    """Whether it is the package, its compiled part, or a class; what is below a member of one is nothing of rclpy."""
    return owner in ("rclpy", COMPILED) or owner.rpartition(".")[2][:1].isupper()


def _is_optional(node: ast.AST) -> bool:
    """Whether its imports are for types alone, or may fail."""
    if isinstance(node, ast.If):
        return isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    return isinstance(node, ast.Try) and any(ast.unparse(each.type or node) == "ImportError" for each in node.handlers)


def _is_protocol(node: ast.ClassDef) -> bool:
    return any(isinstance(base, ast.Name) and base.id == "Protocol" for base in node.bases)


def _functions(node: ast.ClassDef) -> Iterator[ast.FunctionDef]:
    return (each for each in node.body if isinstance(each, ast.FunctionDef))


# ── what a version has ───────────────────────────────────────────────────────────────────────────────────────────────


def names_of(package: Path) -> set[str]:
    """The names of an rclpy, whose Python is in that folder; its C++ beside it, or the types of its compiled part."""
    found: set[str] = set()
    for module in _MODULES:
        path = package.joinpath(*module.split(".")) if module else package / "__init__"
        path = path.with_suffix(".py")
        if path.is_file():
            found |= _in_module(".".join(filter(None, ["rclpy", module])), ast.parse(path.read_text("utf-8")))
    sources = package.parent / "src" / "rclpy"
    types = sorted((package / "impl").glob("_rclpy_*.pyi"))
    if sources.is_dir():
        for path in sorted(sources.glob("*.cpp")):
            found |= _in_cpp(path.read_text("utf-8"))
    elif types:
        found |= _in_module(COMPILED, ast.parse(types[0].read_text("utf-8")))
    # An enumeration of the compiled part that a module calls its own.
    for name in [name for name in found if name.startswith(f"{COMPILED}.SignalHandlerOptions.")]:
        found.add(f"rclpy.signals.{name.removeprefix(COMPILED).lstrip('.')}")
    return {name for name in found if _is_listed(name)}


@cache
def _listed() -> frozenset[str]:
    return frozenset(name.partition("(")[0].rpartition(".")[0] for name in used())


def _is_listed(name: str) -> bool:
    """Whether a list has it: a public name of a module or a class that the bridge uses, or one that it uses itself."""
    plain, is_parameter, _ = name.partition("(")
    owner, _, last = plain.rpartition(".")
    if name in used() or plain in used():
        return True
    return owner in _listed() and not is_parameter and not last.startswith("_")


def _in_module(module: str, tree: ast.Module) -> set[str]:
    found: set[str] = set()
    classes: dict[str, set[str]] = {}
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            inherited = set[str]().union(*(classes.get(ast.unparse(base).partition("[")[0], ()) for base in node.bases))
            classes[node.name] = inherited | set(_in_class(node))
            found |= _of_class(f"{module}.{node.name}", classes[node.name])
        elif isinstance(node, ast.FunctionDef):
            found |= {f"{module}.{node.name}", *(f"{module}.{node.name}({name})" for name in _parameters(node))}
        else:
            for name in _bound(node):
                value = getattr(node, "value", None)
                found |= _of_class(f"{module}.{name}", classes.get(value.id, ()) if isinstance(value, ast.Name) else ())
    return found


def _of_class(name: str, members: Iterable[str]) -> set[str]:
    return {name, *(_below(name, member) for member in members)}


def _below(owner: str, name: str) -> str:
    return f"{owner}{name}" if name.startswith("(") else f"{owner}.{name}"


def _in_class(node: ast.ClassDef) -> Iterator[str]:
    for each in node.body:
        if isinstance(each, (ast.FunctionDef, ast.AsyncFunctionDef)):
            names = [f"({name})" for name in _parameters(each)]
            yield from names if each.name == "__init__" else [each.name, *(f"{each.name}{name}" for name in names)]
            if each.name == "__init__":
                yield from (
                    target.attr
                    for target in ast.walk(each)
                    if isinstance(target, ast.Attribute) and isinstance(target.ctx, ast.Store)
                )
        else:
            yield from _bound(each)


def _bound(node: ast.stmt) -> Iterator[str]:
    """The names that a statement binds; in an enumeration those are its members."""
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        yield from (alias.asname or alias.name for alias in node.names)
    elif isinstance(node, ast.Assign):
        yield from (target.id for target in node.targets if isinstance(target, ast.Name))
    elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        yield node.target.id


def _parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    given = node.args
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs) if each.arg != "self"]
    return [*names, *(["**"] if given.kwarg else [])]


def _in_cpp(text: str) -> set[str]:
    """What is made known to Python: classes with their names, functions, errors."""
    found = {f"{COMPILED}.{error['name']}" for error in _CPP_ERROR.finditer(text)}
    owner = ""
    marks = sorted([*_CPP_CLASS.finditer(text), *_CPP_NAME.finditer(text)], key=re.Match.start)
    for mark in marks:
        if "base" in mark.groupdict():
            owner = f"{COMPILED}.{mark['name']}"
            inherited = ("destroy_when_not_in_use",) if "Destroyable" in mark["base"] else ()
            found |= {owner, *(f"{owner}.{name}" for name in inherited)}
        else:
            found.add(f"{COMPILED}.{mark['name']}" if mark["on"] or not owner else f"{owner}.{mark['name']}")
    return found


if __name__ == "__main__":
    print("\n".join(sorted(names_of(Path(sys.argv[1])))))
