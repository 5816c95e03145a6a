"""The command line: parse arguments, build the settings, run one verb. Without a verb it serves MCP."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.errors import RobotError

if TYPE_CHECKING:
    from ros2_mcp.settings import Settings

CLIENTS = ("claude-desktop", "claude-code", "vscode", "cursor", "codex", "gemini")


def run(argv: Sequence[str]) -> int:
    """Runs the command and returns the process's exit code."""
    arguments = parser().parse_args(_options_first(argv))
    try:
        return _run(arguments)
    except RobotError as error:
        print(f"ros2-mcp: {error}", file=sys.stderr)  # noqa: T201
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
    _add_settings(top)
    verbs = top.add_subparsers(dest="verb", metavar="COMMAND")
    verbs.add_parser("serve", help="serve MCP (the default)")
    verbs.add_parser("doctor", help="say which ROS 2 is used and why, and how to mend what is wrong")
    demo = verbs.add_parser("demo", help="the one-minute tour with a simulated robot")
    demo.add_argument("--robot", action="store_true", help="run only the simulated robot, until it is stopped")
    demo.add_argument("--output", type=Path, help="folder for the pictures and the transcript")
    call = verbs.add_parser("call", help="call one tool, such as: call ros2_topic_list pattern=scan")
    call.add_argument("tool", nargs="?", help="name of the tool; without it the tools are listed")
    call.add_argument("arguments", nargs="*", metavar="key=value", help="its arguments; values may be JSON")
    call.add_argument("--json", action="store_true", help="print the structured result only")
    interfaces = verbs.add_parser("interfaces", help="build interface packages for a ROS 2 from wheels")
    steps = interfaces.add_subparsers(dest="step", metavar="STEP", required=True)
    build = steps.add_parser("build", help="generate and compile .msg, .srv and .action files")
    build.add_argument("directories", nargs="+", type=Path, metavar="DIR", help="a package, or a folder with packages")
    prompts = verbs.add_parser("prompts", help="check a folder of prompts in Markdown")
    steps = prompts.add_subparsers(dest="step", metavar="STEP", required=True)
    check = steps.add_parser("check", help="list the prompts of a folder, and their mistakes by file and line")
    check.add_argument("folder", type=Path, metavar="DIR")
    config = verbs.add_parser("config", help="print the configuration for an MCP client")
    config.add_argument("client", choices=CLIENTS)
    return top


def _add_settings(top: argparse.ArgumentParser) -> None:
    ros = top.add_argument_group("ROS 2")
    ros.add_argument("--distro", help="distribution to use, such as jazzy (default: sourced, else newest installed)")
    ros.add_argument("--workspace", action="append", type=Path, default=None, metavar="DIR", help="overlay to source")
    ros.add_argument("--domain-id", type=int, help="DDS domain (default: ROS_DOMAIN_ID)")
    ros.add_argument("--rmw", help="middleware (default: RMW_IMPLEMENTATION)")
    serving = top.add_argument_group("serving")
    serving.add_argument("--transport", choices=("stdio", "sse", "streamable-http"), help="default: stdio")
    serving.add_argument("--host", help="address for HTTP (default: 127.0.0.1)")
    serving.add_argument("--port", type=int, help="port for HTTP (default: 8123)")
    serving.add_argument("--read-only", action="store_true", default=None, help="leave out tools that write")
    serving.add_argument("--tools", metavar="GROUPS", help="groups of tools, such as default,lifecycle, or all")
    serving.add_argument("--result-bytes", type=int, help="bound on the text of one result (default: 32000)")
    serving.add_argument("--log-level", choices=("debug", "info", "warning", "error"), help="default: warning")
    _add_prompts(top.add_argument_group("prompts"))
    memory = top.add_argument_group("memory")
    memory.add_argument("--record-dir", type=Path, metavar="DIR", help="for recordings (~/ros2-mcp/recordings)")
    memory.add_argument("--bag-dir", type=Path, metavar="DIR", help="where bags are read (default: the recordings)")
    memory.add_argument("--bag", type=Path, metavar="FILE", help="a recording in the place of the robot; needs no ROS")
    memory.add_argument("--black-box", metavar="TOPICS", nargs="?", const="", help="always keep these (all small ones)")
    memory.add_argument("--black-box-bytes", type=int, metavar="N", help="at most so much of it (default: 10^9)")
    memory.add_argument("--black-box-hours", type=float, metavar="H", help="at most so long (default: 24)")
    top.add_argument("--version", action=_Version, nargs=0, help="print the version and end")


def _add_prompts(prompts: Any) -> None:
    switch = {"nargs": "?", "const": "true", "choices": ("true", "false", "1", "0"), "metavar": "true|false"}
    prompts.add_argument("--prompts", type=Path, metavar="DIR", help="folder of your prompts in Markdown")
    prompts.add_argument("--custom-prompts", **switch, help="load prompts of Python packages (default: false)")
    prompts.add_argument("--prompts-local", **switch, help="with --custom-prompts: load a module instead")
    prompts.add_argument("--prompts-path", type=Path, metavar="DIR", help="folder of that module")
    prompts.add_argument("--prompts-module", metavar="NAME", help="its name (default: extension_prompts)")


def _is_on(choice: str | None) -> bool | None:
    return None if choice is None else choice in ("true", "1")


class _Version(argparse.Action):
    """Prints the version; looked up only when asked for, because that is slow."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        parser.exit(message=f"ros2-mcp {version('ros2-mcp')}\n")


def _listed(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(name for name in text.split(",") if name)


def settings_from(arguments: argparse.Namespace) -> Settings:
    """The settings of the environment, with what the command line says on top."""
    from ros2_mcp.settings import Settings

    given = {
        "distro": arguments.distro,
        "workspaces": tuple(arguments.workspace) if arguments.workspace else None,
        "domain_id": arguments.domain_id,
        "rmw": arguments.rmw,
        "transport": arguments.transport,
        "host": arguments.host,
        "port": arguments.port,
        "read_only": arguments.read_only,
        "tools": tuple(arguments.tools.split(",")) if arguments.tools else None,
        "log_level": arguments.log_level,
        "result_bytes": arguments.result_bytes,
        "record_dir": arguments.record_dir,
        "bag_dir": arguments.bag_dir,
        "bag": arguments.bag,
        "black_box": _listed(arguments.black_box),
        "black_box_bytes": arguments.black_box_bytes,
        "black_box_hours": arguments.black_box_hours,
        "prompts": arguments.prompts,
        "custom_prompts": _is_on(arguments.custom_prompts),
        "prompts_local": _is_on(arguments.prompts_local),
        "prompts_path": arguments.prompts_path,
        "prompts_module": arguments.prompts_module,
    }
    return Settings.from_environment(os.environ, **given)


def _run(arguments: argparse.Namespace) -> int:
    if arguments.verb == "config":
        from ros2_mcp.commands.config import print_config

        return print_config(arguments.client, sys.argv[1:])
    settings = settings_from(arguments)
    if arguments.verb in (None, "serve"):
        from ros2_mcp.commands.serve import serve

        return serve(settings)
    if arguments.verb == "doctor":
        from ros2_mcp.commands.doctor import doctor

        return doctor(settings)
    if arguments.verb == "demo":
        from ros2_mcp.commands.demo import demo

        return demo(settings, robot_only=arguments.robot, output=arguments.output)
    if arguments.verb == "prompts":
        from ros2_mcp.commands.prompts import check_prompts

        return check_prompts(arguments.folder)
    if arguments.verb == "interfaces":
        from ros2_mcp.commands.interfaces import build_interfaces

        return build_interfaces(settings, arguments.directories)
    from ros2_mcp.commands.call import call

    return call(settings, arguments.tool, arguments.arguments, as_json=arguments.json)
