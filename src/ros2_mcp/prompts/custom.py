"""Prompts in the Python code of users: installed packages (entry points) or a module in a folder. Off by default.

Whatever that code does wrong is told, and the server goes on without it.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import entry_points
from itertools import chain
from pathlib import Path
from typing import Any, cast

from mcp.server.mcpserver.prompts import Prompt as SdkPrompt

from ros2_mcp.prompts import foreign
from ros2_mcp.prompts.arguments import Argument, shown
from ros2_mcp.prompts.mistakes import Mistake, Tell
from ros2_mcp.prompts.prompt import Message, Prompt

GROUP = "mcp_ros_2.prompts"
HOOKS = ("register_prompts", "ALL_PROMPTS", "get_prompts")


def from_entry_points(tell: Tell) -> list[Prompt]:
    """The prompts of installed packages that declare the group `mcp_ros_2.prompts`."""
    prompts: list[Prompt] = []
    for entry in entry_points(group=GROUP):
        prompts += _guarded(f"entry point {entry.name} ({entry.value})", lambda entry=entry: _made(entry.load()), tell)
    return prompts


def from_module(folder: Path | None, module: str, tell: Tell) -> list[Prompt]:
    """The prompts of a module: `register_prompts()`, `ALL_PROMPTS` or `get_prompts()`, the first that it has."""
    if folder is not None:
        path = str(folder.expanduser().resolve())
        if path not in sys.path:
            sys.path.insert(0, path)

    def load() -> Iterator[Prompt]:
        loaded = importlib.import_module(module)
        hook = next((name for name in HOOKS if hasattr(loaded, name)), None)
        if hook is None:
            raise ImportError(f"it has none of {', '.join(HOOKS)}")
        return _made(getattr(loaded, hook))

    return _guarded(f"module {module}", load, tell)


def _guarded(what: str, load: Callable[[], Iterator[Prompt]], tell: Tell) -> list[Prompt]:
    prompts: list[Prompt] = []
    try:
        with foreign.stand_in():
            prompts.extend(load())
    except (Exception, SystemExit) as error:  # noqa: BLE001 - the code of a user may raise anything
        tell(Mistake(f"prompts of {what}", 0, f"{type(error).__name__}: {error}"))
    return prompts


def _made(hook: Any) -> Iterator[Prompt]:
    """The prompts behind what a hook is: things, a function that returns them, or one that registers them."""
    registry = Registry()
    things = hook
    if callable(hook) and not foreign.is_of_that_shape(hook):
        takes_registry = any(p.default is p.empty for p in inspect.signature(hook).parameters.values())
        things = hook(registry) if takes_registry else hook()
    elif inspect.isclass(hook):
        things = hook()
    listed = cast("Iterable[Any]", things if isinstance(things, (list, tuple, Iterator)) else [things])
    for thing in chain(listed, registry.things):
        if thing is not None:
            yield _adopted(thing)


def _adopted(thing: Any) -> Prompt:
    if isinstance(thing, Prompt):
        return thing
    if isinstance(thing, SdkPrompt):
        return _from_sdk(thing)
    if inspect.isclass(thing):
        return _adopted(thing())
    if foreign.is_of_that_shape(thing):
        return foreign.adopt(thing)
    if callable(thing):
        return _from_sdk(SdkPrompt.from_function(cast("Callable[..., str]", thing)))
    raise TypeError(f"{thing!r} is not a prompt")


class Registry:
    """What a `register_prompts(mcp)` gets: it takes prompts as a FastMCP server does."""

    def __init__(self) -> None:
        self.things: list[SdkPrompt] = []

    def prompt(self, name: Any = None, title: str | None = None, description: str | None = None, **_: Any) -> Any:
        """The decorator `@mcp.prompt`, with and without arguments."""

        def take(function: Any) -> Any:
            given = name if isinstance(name, str) else None
            self.things.append(SdkPrompt.from_function(function, name=given, title=title, description=description))
            return function

        return take(name) if callable(name) else take

    def add_prompt(self, prompt: SdkPrompt) -> None:
        """A prompt that is already made."""
        self.things.append(prompt)


def _from_sdk(made: SdkPrompt) -> Prompt:
    arguments = [
        Argument(argument.name, argument.description or "", required=argument.required)
        for argument in made.arguments or []
    ]

    async def write(values: Any) -> list[Message]:
        given = {name: shown(value) for name, value in values.items() if value is not None}
        messages = await foreign.rendered(made.name, lambda: made.render(given, cast("Any", None)))
        return list(messages)

    return Prompt(made.name, made.title or made.name, made.description or "", arguments, write)
