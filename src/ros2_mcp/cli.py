"""The command line: parse arguments, build the settings, run one verb. Without a verb it serves MCP.

The modules of the verbs are imported when they are run: the bridge is launched before the heavy ones are (`serve`).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import LAYOUT, visible
from ros2_mcp.settings import OPTIONS, Option, Settings

# The clients of `commands/config.py`, which is imported only when it is run.
CLIENTS = (
    *("claude-desktop", "claude-code", "vscode", "cursor", "codex", "gemini", "antigravity", "warp", "windsurf"),
    *("cline", "zed", "goose", "lm-studio", "jetbrains"),
)


@dataclass(frozen=True, slots=True)
class Verb:
    """One command: its line in `--help`, its own arguments, and what it does."""

    help: str
    run: Callable[[argparse.Namespace], int]
    declare: Callable[[argparse.ArgumentParser], Any] = lambda _: None


def _serve(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.serve import serve

    return serve(settings_from(arguments))


def _doctor(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.doctor import doctor

    return doctor(settings_from(arguments))


def _declare_demo(demo: argparse.ArgumentParser) -> None:
    demo.add_argument("--robot", action="store_true", help="run only the simulated robot, until it is stopped")
    demo.add_argument("--output", type=Path, help="folder for the pictures and the transcript")


def _demo(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.demo import demo

    return demo(settings_from(arguments), robot_only=arguments.robot, output=arguments.output)


def _declare_call(call: argparse.ArgumentParser) -> None:
    call.add_argument("tool", nargs="?", help="name of the tool; without it the tools are listed")
    call.add_argument("arguments", nargs="*", metavar="key=value", help="its arguments; values may be JSON")
    call.add_argument("--json", action="store_true", help="print the structured result only")


def _call(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.call import call

    return call(settings_from(arguments), arguments.tool, arguments.arguments, as_json=arguments.json)


def _declare_interfaces(interfaces: argparse.ArgumentParser) -> None:
    steps = interfaces.add_subparsers(dest="step", metavar="STEP", required=True)
    build = steps.add_parser("build", help="generate and compile .msg, .srv and .action files")
    build.add_argument("directories", nargs="+", type=Path, metavar="DIR", help="a package, or a folder with packages")


def _interfaces(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.interfaces import build_interfaces

    return build_interfaces(settings_from(arguments), arguments.directories)


def _declare_prompts(prompts: argparse.ArgumentParser) -> None:
    steps = prompts.add_subparsers(dest="step", metavar="STEP", required=True)
    check = steps.add_parser("check", help="list the prompts of a folder, and their mistakes by file and line")
    check.add_argument("folder", type=Path, metavar="DIR")


def _prompts(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.prompts import check_prompts

    settings_from(arguments)  # a wrong option is an error here, too
    return check_prompts(arguments.folder)


def _config(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.config import print_config

    return print_config(arguments.client, arguments, settings_from(arguments))


VERBS: Mapping[str, Verb] = {
    "serve": Verb("serve MCP (the default)", _serve),
    "doctor": Verb("say which ROS 2 is used and why, and how to mend what is wrong", _doctor),
    "demo": Verb("the one-minute tour with a simulated robot", _demo, _declare_demo),
    "call": Verb("call one tool, such as: call ros2_topic_list pattern=scan", _call, _declare_call),
    "interfaces": Verb("build interface packages for a ROS 2 from wheels", _interfaces, _declare_interfaces),
    "prompts": Verb("check a folder of prompts in Markdown", _prompts, _declare_prompts),
    "config": Verb(
        "print the configuration for an MCP client",
        _config,
        lambda config: config.add_argument("client", choices=CLIENTS),
    ),
}


def run(argv: Sequence[str]) -> int:
    """Runs the command and returns the process's exit code."""
    arguments = parser().parse_args(_options_first(argv))
    try:
        return VERBS[arguments.verb or "serve"].run(arguments)
    except RobotError as error:
        print(f"ros2-mcp: {visible(str(error), keep=LAYOUT)}", file=sys.stderr)  # noqa: T201
        return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # Whoever read our output has seen enough; nothing more may be written to it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _options_first(argv: Sequence[str]) -> list[str]:
    """`call TOOL --json key=value` as argparse takes it: the option before the words."""
    if "call" not in argv or "--json" not in argv:
        return list(argv)
    after = list(argv).index("call") + 1
    return [*argv[:after], "--json", *(word for word in argv[after:] if word != "--json")]


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    top = argparse.ArgumentParser(
        prog="ros2-mcp",
        description="Model Context Protocol server for ROS 2. Without a command it serves MCP over stdio.",
    )
    for title in dict.fromkeys(option.group for option in OPTIONS.values()):
        group = top.add_argument_group(title)
        for option in OPTIONS.values():
            if option.group == title:
                group.add_argument(option.flag, **_argument(option))
    top.add_argument("--version", action=_Version, nargs=0, help="print the version and end")
    verbs = top.add_subparsers(dest="verb", metavar="COMMAND")
    for name, verb in VERBS.items():
        verb.declare(verbs.add_parser(name, help=verb.help))
    return top


def _argument(option: Option) -> dict[str, Any]:
    """An option as `add_argument` takes it. Its values stay text here: `Option.parse` gives the same errors for all."""
    default = f" (default: {option.default_text})" if option.default_text else ""
    keywords: dict[str, Any] = {"dest": option.name, "help": option.help + default.replace("%", "%%"), "default": None}
    if not option.takes_value:
        return {**keywords, "action": "store_const", "const": "true"}
    keywords["metavar"] = option.kind.metavar
    if option.alone is not None:
        keywords |= {"nargs": "?", "const": option.alone}
    return {**keywords, "action": "append"} if option.kind.several else keywords


class _Version(argparse.Action):
    """Prints the version; looked up only when asked for, because that is slow."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        parser.exit(message=f"ros2-mcp {version('ros2-mcp')}\n")


def settings_from(arguments: argparse.Namespace) -> Settings:
    """The settings of the environment, with what the command line says on top."""
    words: Mapping[str, str | list[str] | None] = vars(arguments)
    overrides: dict[str, Any] = {}
    for name, option in OPTIONS.items():
        word = words[name]
        if word is not None:
            overrides[name] = option.parse(word if isinstance(word, str) else os.pathsep.join(word))
    return Settings.from_environment(os.environ, **overrides)
