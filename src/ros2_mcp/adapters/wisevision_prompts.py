"""Prompts in users' Python code, as the WiseVision server loads them: from installed packages (entry points), or from
a module in a folder. Off by default. If that code fails, the error is reported, and the server runs without it.

Such code returns objects of two classes that it imports from `server.prompthandler`, or plain functions, or registers
functions as on a FastMCP server. If there is no package `server`, a stand-in with these two classes is provided.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from mcp.server.mcpserver.prompts import Prompt as SdkPrompt
from mcp.types import GetPromptResult, PromptArgument, PromptMessage, TextContent
from mcp.types import Prompt as ListedPrompt

from ros2_mcp.model.arguments import Argument, shown
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.prompts.mistakes import Mistake, Tell
from ros2_mcp.prompts.prompt import Message, Prompt
from ros2_mcp.settings import Settings

GROUP = "mcp_ros_2.prompts"
HOOKS = ("register_prompts", "ALL_PROMPTS", "get_prompts")
_KINDS = {"number": "number", "boolean": "boolean"}


def code_of(settings: Settings) -> Callable[[Tell], Sequence[Prompt]] | None:
    """Return a function that loads the prompts of the user's code; None if the settings do not enable them."""
    if not settings.custom_prompts:
        return None
    if settings.prompts_local:
        return lambda tell: from_module(settings.prompts_path, settings.prompts_module, tell)
    return from_entry_points


def from_entry_points(tell: Tell) -> list[Prompt]:
    """Return the prompts of installed packages that declare the entry point group `mcp_ros_2.prompts`."""
    prompts: list[Prompt] = []
    for entry in entry_points(group=GROUP):
        prompts += _guarded(f"entry point {entry.name} ({entry.value})", lambda entry=entry: _made(entry.load()), tell)
    return prompts


def from_module(folder: Path | None, module: str, tell: Tell) -> list[Prompt]:
    """Return the prompts of a module: of `register_prompts()`, `ALL_PROMPTS` or `get_prompts()`, whichever it has
    first.
    """
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
        with _stand_in():
            prompts.extend(load())
    except (Exception, SystemExit) as error:  # noqa: BLE001 - the code of a user may raise anything
        tell(Mistake(f"prompts of {what}", 0, f"{type(error).__name__}: {error}"))
    return prompts


def _made(hook: Any) -> Iterator[Prompt]:
    """Yield the prompts of a hook: a list of prompts, a function that returns them, or a function that
    registers them.
    """
    registry = _Registry()
    things = hook
    if callable(hook) and not _describes_itself(hook):
        takes_registry = any(p.default is p.empty for p in inspect.signature(hook).parameters.values())
        things = hook(registry) if takes_registry else hook()
    elif inspect.isclass(hook):
        things = hook()
    listed = cast("Iterable[Any]", things if isinstance(things, (list, tuple, Iterator)) else [things])
    for thing in chain(listed, registry.things):
        if thing is not None:
            yield _adopted(thing() if inspect.isclass(thing) else thing)


def _adopted(thing: Any) -> Prompt:
    if isinstance(thing, Prompt):
        return thing
    if isinstance(thing, SdkPrompt):
        arguments = [Argument(a.name, a.description or "", required=a.required) for a in thing.arguments or []]
        return _prompt(thing, arguments, lambda texts: thing.render(texts, cast("Any", None)))
    if _describes_itself(thing):
        listed: ListedPrompt = thing.get_prompt_description()
        specs: dict[str, Any] = {spec.name: spec for spec in cast("list[Any]", getattr(thing, "args", None) or [])}
        arguments = [_argument(argument, specs.get(argument.name)) for argument in listed.arguments or []]
        empty = {argument.name: "" for argument in arguments}  # `str.format` needs a value for each
        return _prompt(listed, arguments, lambda texts: thing.render({**empty, **texts}))
    if callable(thing):
        return _adopted(SdkPrompt.from_function(cast("Callable[..., str]", thing)))
    raise TypeError(f"{thing!r} is not a prompt")


def _describes_itself(thing: Any) -> bool:
    """Return whether an object describes and renders itself, as the prompt handlers of that server do."""
    return callable(getattr(thing, "get_prompt_description", None)) and callable(getattr(thing, "render", None))


def _argument(listed: PromptArgument, spec: Any) -> Argument:
    """Return the argument with the kind, choices and default of its specification; without them if they do not fit."""
    plain = Argument(listed.name, listed.description or "", required=bool(listed.required))
    if spec is None:
        return plain
    bare = Argument(plain.name, plain.description, _KINDS.get(spec.type, "string"), plain.required)
    try:
        choices = [bare.value(shown(choice)) for choice in spec.enum or ()]
        default = None if spec.default is None else bare.value(shown(spec.default))
    except BadInput:
        return plain
    return Argument(bare.name, bare.description, bare.kind, bare.required, default, choices)


def _prompt(described: ListedPrompt | SdkPrompt, arguments: Sequence[Argument], render: Callable[[Any], Any]) -> Prompt:
    name = described.name

    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        texts = {argument: shown(value) for argument, value in values.items() if value is not None}
        try:
            result = await asyncio.to_thread(render, texts)  # in a thread, because it may take long
            result = await result if inspect.isawaitable(result) else result
            return [_message(message) for message in getattr(result, "messages", result)]
        except Exception as error:  # code of the user can raise anything
            raise RobotError(f"The prompt {name} failed: {type(error).__name__}: {error}") from error

    return Prompt(name, described.title or name, described.description or "", arguments, write)


def _message(message: Any) -> Message:
    content = message.content
    text = getattr(content, "text", None)
    return Message(text if isinstance(text, str) else content.model_dump_json(by_alias=True), message.role)


class _Registry:
    """The argument of `register_prompts(mcp)`: it collects prompts like a FastMCP server."""

    def __init__(self) -> None:
        self.things: list[SdkPrompt] = []

    def prompt(self, name: Any = None, title: str | None = None, description: str | None = None, **_: Any) -> Any:
        """Collect a prompt: the decorator `@mcp.prompt`, with or without arguments."""

        def take(function: Any) -> Any:
            own_name = name if isinstance(name, str) else None
            self.things.append(SdkPrompt.from_function(function, name=own_name, title=title, description=description))
            return function

        return take(name) if callable(name) else take

    def add_prompt(self, prompt: SdkPrompt) -> None:
        """Collect a finished prompt."""
        self.things.append(prompt)


# ── the two classes of `server.prompthandler` ────────────────────────────────────────────────────────────────────


@dataclass
class ArgSpec:
    """One argument, as WiseVision's modules declare it."""

    name: str
    description: str = ""
    required: bool = True
    type: str = "string"
    enum: list[Any] | None = None
    default: Any = None


@dataclass
class BasePromptHandler:
    """One prompt, as WiseVision's modules declare it, with templates for `str.format`."""

    name: str
    description: str
    args: list[ArgSpec] = field(default_factory=list[ArgSpec])
    messages_template: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    namespace: str = ""

    def get_prompt_description(self) -> ListedPrompt:
        """Return the prompt as it is listed."""
        arguments = [PromptArgument(name=a.name, description=a.description, required=a.required) for a in self.args]
        full_name = f"{self.namespace}.{self.name}" if self.namespace else self.name
        return ListedPrompt(name=full_name, description=self.description, arguments=arguments)

    def render(self, arguments: Mapping[str, Any] | None) -> GetPromptResult:
        """Return the messages, with each `{name}` replaced."""
        values = dict(arguments or {})
        return GetPromptResult(
            description=self.description,
            messages=[
                PromptMessage(role=cast("Any", role), content=TextContent(type="text", text=text.format(**values)))
                for role, text in self.messages_template
            ],
        )


@contextlib.contextmanager
def _stand_in() -> Generator[None]:
    """Provide `server.prompthandler` during an import, unless a package `server` is installed."""
    installed = importlib.util.find_spec("server") if "server" not in sys.modules else None
    if "server" in sys.modules or (installed is not None and installed.origin is not None):
        yield  # an empty folder named `server`, which Python takes for a package without an origin, does not count
        return
    package, module = ModuleType("server"), ModuleType("server.prompthandler")
    package.__path__ = []
    vars(module).update(ArgSpec=ArgSpec, BasePromptHandler=BasePromptHandler)
    vars(package).update(prompthandler=module)
    sys.modules.update({"server": package, "server.prompthandler": module})
    try:
        yield
    finally:
        del sys.modules["server"], sys.modules["server.prompthandler"]
