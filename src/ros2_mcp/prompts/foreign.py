"""Prompts written for the WiseVision server: the two classes that such modules import, and any object of their shape.

Those modules say `from server import prompthandler`. Where there is no such package, one with these two classes
stands in while they are imported.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import inspect
import sys
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, cast

from mcp.types import GetPromptResult, PromptArgument, PromptMessage, TextContent
from mcp.types import Prompt as ListedPrompt

from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.prompts.arguments import Argument, shown
from ros2_mcp.prompts.prompt import Message, Prompt

_KINDS = {"number": "number", "boolean": "boolean"}


@dataclass
class ArgSpec:
    """One argument, as those modules declare it."""

    name: str
    description: str = ""
    required: bool = True
    type: str = "string"
    enum: list[Any] | None = None
    default: Any = None


@dataclass
class BasePromptHandler:
    """One prompt, as those modules declare it: templates in the manner of `str.format`."""

    name: str
    description: str
    args: list[ArgSpec] = field(default_factory=list[ArgSpec])
    messages_template: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    namespace: str = ""

    def get_prompt_description(self) -> ListedPrompt:
        """The prompt as it is listed."""
        arguments = [PromptArgument(name=a.name, description=a.description, required=a.required) for a in self.args]
        full_name = f"{self.namespace}.{self.name}" if self.namespace else self.name
        return ListedPrompt(name=full_name, description=self.description, arguments=arguments)

    def render(self, arguments: Mapping[str, Any] | None) -> GetPromptResult:
        """The messages with `{name}` replaced."""
        given = dict(arguments or {})
        return GetPromptResult(
            description=self.description,
            messages=[
                PromptMessage(role=cast("Any", role), content=TextContent(type="text", text=text.format(**given)))
                for role, text in self.messages_template
            ],
        )


@contextlib.contextmanager
def stand_in() -> Generator[None]:
    """Offers `server.prompthandler` for the time of an import, where no package `server` is installed."""
    installed = importlib.util.find_spec("server") if "server" not in sys.modules else None
    if "server" in sys.modules or (installed is not None and installed.origin is not None):
        yield  # a mere folder of that name, which Python takes for a package without an origin, does not count
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


def is_of_that_shape(thing: Any) -> bool:
    """Whether it describes and renders itself as those prompts do."""
    return callable(getattr(thing, "get_prompt_description", None)) and callable(getattr(thing, "render", None))


def adopt(thing: Any) -> Prompt:
    """The prompt behind such an object."""
    listed: ListedPrompt = thing.get_prompt_description()
    specs: dict[str, Any] = {spec.name: spec for spec in cast("list[Any]", getattr(thing, "args", None) or [])}
    arguments = [_argument(listing, specs.get(listing.name)) for listing in listed.arguments or []]

    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        given = {name: shown(value) for name, value in values.items() if value is not None}
        for missing in [argument.name for argument in arguments if argument.name not in given]:
            given[missing] = ""
        return await rendered(listed.name, lambda: thing.render(given))

    return Prompt(listed.name, listed.title or listed.name, listed.description or "", arguments, write)


def _argument(listed: PromptArgument, spec: Any) -> Argument:
    description = listed.description or ""
    if spec is None:
        return Argument(listed.name, description, required=bool(listed.required))
    bare = Argument(listed.name, description, _KINDS.get(spec.type, "string"), required=bool(listed.required))
    try:
        choices = [bare.value(shown(choice)) for choice in spec.enum or ()]
        default = None if spec.default is None else bare.value(shown(spec.default))
    except BadInput:
        return Argument(listed.name, description, required=bool(listed.required))
    return Argument(bare.name, description, bare.kind, bare.required, default, choices)


async def rendered(name: str, render: Any) -> Sequence[Message]:
    """The messages that code of the user makes, which runs in a thread of its own because it may take its time.

    Raises:
        RobotError: naming what that code raised.
    """
    try:
        result = await asyncio.to_thread(render)
        result = await result if inspect.isawaitable(result) else result
        return [_message(message) for message in getattr(result, "messages", result)]
    except Exception as error:  # code of the user can raise anything
        raise RobotError(f"The prompt {name} failed: {type(error).__name__}: {error}") from error


def _message(message: Any) -> Message:
    content = message.content
    text = getattr(content, "text", None)
    return Message(text if isinstance(text, str) else content.model_dump_json(by_alias=True), message.role)
