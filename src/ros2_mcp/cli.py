"""The command line: parse arguments, build the settings, run one command. Without a command, serve MCP.

The module of a command is imported when the command is run, because the imports are slow: `serve` launches the bridge
before them.
"""

from __future__ import annotations

import argparse
import io
import itertools
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
    *("claude-desktop", "claude-code", "vscode", "cursor", "codex", "gemini", "opencode", "antigravity", "warp"),
    *("windsurf", "cline", "zed", "goose", "lm-studio", "jetbrains"),
)


@dataclass(frozen=True, slots=True)
class Verb:
    """One command: its line in `--help`, the function that runs it, and the function that declares its arguments."""

    help: str
    run: Callable[[argparse.Namespace], int]
    declare: Callable[[argparse.ArgumentParser], Any] = lambda _: None


def _serve(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.serve import serve

    return serve(settings_from(arguments))


def _doctor(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.doctor import doctor
    from ros2_mcp.compose.entries import entries_of

    codes: list[int] = []
    for entry in entries_of(settings_from(arguments)):
        if entry.name:
            print(f"{chr(10) if codes else ''}The robot {entry.name}, {entry.settings.robot.text}:")  # noqa: T201
        codes.append(doctor(entry.settings))
    return max(codes)


def _declare_robot(verb: argparse.ArgumentParser) -> None:
    """Declare the options of the robot and its ROS 2 after the command, too, where people write them."""
    for option in _of_robot():
        keywords = _argument(option)
        keywords["default"] = argparse.SUPPRESS  # an option before the command applies unless it is repeated after it
        verb.add_argument(option.flag, **keywords)


def _of_robot() -> list[Option]:
    return [option for option in OPTIONS.values() if option.group in ("robot", "ROS 2")]


def _declare_demo(demo: argparse.ArgumentParser) -> None:
    from ros2_mcp.commands.robots import DEFAULT, ROBOTS

    only = f"run only this simulated robot, until it is stopped: {', '.join(ROBOTS)} (without a name: {DEFAULT})"
    demo.add_argument("--robot", dest="simulated", nargs="?", const=DEFAULT, choices=ROBOTS, metavar="ROBOT", help=only)
    demo.add_argument("--tour", action="store_true", help="with --robot: the tour with that robot")
    demo.add_argument("--output", type=Path, help="folder for the pictures and the transcript")


def _demo(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.demo import demo
    from ros2_mcp.commands.robots import DEFAULT

    robot_only = arguments.simulated is not None and not arguments.tour
    robot = arguments.simulated or DEFAULT
    return demo(settings_from(arguments), robot=robot, robot_only=robot_only, output=arguments.output)


def _declare_call(call: argparse.ArgumentParser) -> None:
    _declare_robot(call)
    call.add_argument("tool", nargs="?", help="name of the tool; without it the tools are listed")
    call.add_argument("arguments", nargs="*", metavar="key=value", help="its arguments; values may be JSON")
    call.add_argument("--json", action="store_true", help="print the structured result only")
    call.add_argument("--output", type=Path, metavar="DIR", help="folder for pictures (default: of temporary files)")
    call.add_argument(
        "-h", "--help", action=_HelpOnTool, nargs=0, help="show this; after the name of a tool, what that tool takes"
    )


class _HelpOnTool(argparse.Action):
    """Print the help of `call`; after the name of a tool, request the help of that tool."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *_: Any) -> None:
        if namespace.tool is None:
            parser.print_help()
            parser.exit()
        namespace.help = True


def _call(arguments: argparse.Namespace) -> int:
    from ros2_mcp.compose.entries import named_in

    settings, words = named_in(settings_from(arguments), arguments.arguments, needed=bool(arguments.tool))
    if arguments.tool is None or arguments.help:
        from ros2_mcp.commands.tool_help import print_help

        return print_help(settings, arguments.tool)
    from ros2_mcp.commands.call import call

    return call(settings, arguments.tool, words, as_json=arguments.json, output=arguments.output)


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


def _declare_config(config: argparse.ArgumentParser) -> None:
    _declare_robot(config)
    config.add_argument("client", choices=CLIENTS, metavar="CLIENT", help=", ".join(CLIENTS))
    config.add_argument("--http", action="store_true", help="for a server that runs already, over HTTP: URL and token")


def _connect(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.connect import connect

    return connect(arguments.path)


def _declare_token(token: argparse.ArgumentParser) -> None:
    token.add_argument("name", metavar="NAME", help="what the client is called in logs")
    token.add_argument(
        "--scopes", default="observe,act,stop", metavar="SCOPES", help="of observe,act,stop (default: all three)"
    )


def _token(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.token import print_token

    return print_token(settings_from(arguments), arguments.name, arguments.scopes.split(","))


def _config(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.config import print_config

    return print_config(arguments.client, arguments, settings_from(arguments))


_STATE = "the robot's state folder (default: that of the settings)"


def _declare_view(view: argparse.ArgumentParser) -> None:
    _declare_robot(view)
    bag = OPTIONS["bag"]
    keywords = _argument(bag)
    keywords["default"] = argparse.SUPPRESS  # as in `_declare_robot`
    view.add_argument(bag.flag, **keywords)
    # not --port, which is the port of MCP over HTTP
    view.add_argument("--page-port", type=int, default=0, metavar="N", help="on 127.0.0.1 (default: any that is free)")
    view.add_argument("--state", type=Path, metavar="DIR", help=_STATE)


def _view(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.view import view
    from ros2_mcp.compose.entries import only_one

    settings = only_one(settings_from(arguments), "view")
    return view(settings, _state(arguments), arguments.page_port)


def _declare_operate(operate: argparse.ArgumentParser) -> None:
    steps = "list, show ID, approve ID, deny ID, grant ID 10m linear=0.2, revoke ID, mode MODE, stop, reset"
    operate.add_argument("step", nargs="?", default="", metavar="STEP", help=f"{steps}; without it, a screen")
    operate.add_argument("arguments", nargs="*", metavar="WORD", help="what it is about")
    operate.add_argument("--json", action="store_true", help="print the answers as JSON")
    operate.add_argument("--state", type=Path, metavar="DIR", help=_STATE)


def _operate(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.operate import operate

    return operate(_state(arguments), arguments.step, arguments.arguments, as_json=arguments.json)


def _declare_audit(audit: argparse.ArgumentParser) -> None:
    audit.add_argument("step", choices=("show", "verify"), metavar="STEP", help="show the last lines, or verify all")
    audit.add_argument("--limit", type=int, default=50, metavar="N", help="show the newest so many (default: 50)")
    audit.add_argument("--json", action="store_true", help="show the lines as they are written")
    audit.add_argument("--head", default="", help="verify that this line, copied from ros2_status, is still there")
    audit.add_argument("--state", type=Path, metavar="DIR", help=_STATE)


def _audit(arguments: argparse.Namespace) -> int:
    from ros2_mcp.commands.audit import audit
    from ros2_mcp.commands.operate import folder_of
    from ros2_mcp.guard.consent import AUDIT

    folder = (arguments.state or folder_of(_state(arguments))) / AUDIT
    return audit(folder, arguments.step, limit=arguments.limit, as_json=arguments.json, head=arguments.head)


def _state(arguments: argparse.Namespace) -> Path:
    """Return `--state`, or else the state folder of the only robot."""
    if arguments.state:
        return arguments.state
    from ros2_mcp.compose.entries import only_one
    from ros2_mcp.guard.policy_file import policy_for
    from ros2_mcp.guard.state import state_of

    settings = only_one(settings_from(arguments), arguments.verb)
    return state_of(settings, policy_for(settings)).path


def _declare_policy(policy: argparse.ArgumentParser) -> None:
    steps = policy.add_subparsers(dest="step", metavar="STEP", required=True)
    which: dict[str, Any] = {"metavar": "POLICY", "help": "a file, or the name of a profile"}
    check = steps.add_parser("check", help="find its mistakes, and say what it allows in words")
    check.add_argument("which", **which)
    explain = steps.add_parser("explain", help="say what it decides about one command, and why")
    explain.add_argument("which", **which)
    explain.add_argument(
        "command", help='in quotes, such as: \'publish /cmd_vel geometry_msgs/Twist {"linear": {"x": 0.1}}\''
    )
    diff = steps.add_parser("diff", help="name each difference of two")
    diff.add_argument("which", **which)
    diff.add_argument("other", **which)
    test = steps.add_parser("test", help="hold it to a table of commands")
    test.add_argument("which", **which)
    test.add_argument("table", type=Path, metavar="TABLE.csv", help="verb, name, type, value, …, decision")
    init = steps.add_parser("init", help="write a commented draft from the robot that is seen now")
    init.add_argument("--output", type=Path, metavar="FILE", help="a new file (default: to stdout)")


def _policy(arguments: argparse.Namespace) -> int:
    settings = settings_from(arguments)
    from ros2_mcp.commands import policy

    match arguments.step:
        case "check":
            return policy.check(arguments.which)
        case "explain":
            return policy.explain(arguments.which, arguments.command)
        case "diff":
            return policy.diff(arguments.which, arguments.other)
        case "test":
            return policy.test(arguments.which, arguments.table)
        case _:
            from ros2_mcp.compose.entries import only_one

            return policy.init(only_one(settings, "policy init"), arguments.output)


VERBS: Mapping[str, Verb] = {
    "serve": Verb("serve MCP (the default)", _serve, _declare_robot),
    "doctor": Verb("say which ROS 2 is used and why, and how to mend what is wrong", _doctor, _declare_robot),
    "demo": Verb("the one-minute tour with a simulated robot", _demo, _declare_demo),
    "call": Verb("call one tool, such as: call ros2_topic_list pattern=scan", _call, _declare_call),
    "interfaces": Verb("build interface packages for a ROS 2 from wheels", _interfaces, _declare_interfaces),
    "operate": Verb("approve, deny, stop, reset the latch: the operator's terminal", _operate, _declare_operate),
    "view": Verb("show what the agent sees and does, and a stop button, in a browser", _view, _declare_view),
    "audit": Verb("show what was done, or verify that the audit was not changed", _audit, _declare_audit),
    "prompts": Verb("check a folder of prompts in Markdown", _prompts, _declare_prompts),
    "policy": Verb("check, explain, compare and draft what an agent may do", _policy, _declare_policy),
    "config": Verb("print the configuration for an MCP client", _config, _declare_config),
    "connect": Verb(
        "speak stdio with a server at a Unix socket (--socket)",
        _connect,
        lambda connect: connect.add_argument("path", type=Path, metavar="PATH", help="the socket"),
    ),
    "token": Verb("add a token to a file (--token-file), and print it", _token, _declare_token),
}


class _Parser(argparse.ArgumentParser):
    """A parser that suggests corrections of misspelt words."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        choices = [str(choice) for choice in action.choices or ()]
        if action.choices is None or value in choices:
            return
        import difflib  # a slow import, only needed after an error

        near = difflib.get_close_matches(str(value).lower(), choices, n=2)
        hint = f"Did you mean {' or '.join(near)}?" if near else f"Choose from: {', '.join(choices)}."
        what = (action.metavar or action.dest).lower() if isinstance(action.metavar, str) else action.dest
        raise argparse.ArgumentError(None, f"There is no {what} {value!r}. {hint}")


def run(argv: Sequence[str]) -> int:
    """Run the command, and return the exit code of the process."""
    if sys.platform == "win32":  # otherwise piped text is in the characters of a code page
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(encoding="utf-8", errors="replace")
    top = parser()
    arguments, unknown = top.parse_known_args(_options_first(argv))
    if unknown:
        top.exit(2, f"ros2-mcp: {_not_taken(arguments.verb, unknown)}\n")
    try:
        return VERBS[arguments.verb or "serve"].run(arguments)
    except RobotError as error:
        print(f"ros2-mcp: {visible(str(error), keep=LAYOUT)}", file=sys.stderr)  # noqa: T201
        return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader has closed its end of the pipe; nothing more may be written to it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _not_taken(verb: str | None, unknown: Sequence[str]) -> str:
    """Return the error about words that a command does not take, in one line: the usage text would hide it."""
    flags = {option.flag for option in OPTIONS.values()}
    if ours := next((flag for word in unknown if (flag := word.partition("=")[0]) in flags), None):
        return f"{ours} has to stand before the command: ros2-mcp {ours} … {verb} …"
    help_of = " ".join(filter(None, ("ros2-mcp", verb, "--help")))
    return f"{visible(' '.join(unknown))} is not taken here: {help_of} lists what is."


def _options_first(argv: Sequence[str]) -> list[str]:
    """Reorder the arguments of `call` for argparse: options before the words, `--help` after them."""
    if "call" not in argv:
        return list(argv)
    at = list(argv).index("call") + 1
    valued = {"--output", *(option.flag for option in _of_robot() if option.takes_value)}
    options: list[str] = []
    words: list[str] = []
    helps: list[str] = []
    rest = iter(argv[at:])
    for word in rest:
        flag, is_whole, _ = word.partition("=")
        if word in valued:
            options += [word, *itertools.islice(rest, 1)]
        elif word == "--json" or (is_whole and flag in valued):
            options.append(word)
        else:
            (helps if word in ("-h", "--help") else words).append(word)
    return [*argv[:at], *options, *words, *helps]


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    top = _Parser(
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
        verb.declare(verbs.add_parser(name, help=verb.help, add_help=name != "call"))  # `call` has its own
    return top


def _argument(option: Option) -> dict[str, Any]:
    """Return the arguments of `add_argument` for an option. Values stay text: `Option.parse` parses them, so that
    errors are the same on the command line and in the environment.
    """
    default = f" (default: {option.default_text})" if option.default_text else ""
    keywords: dict[str, Any] = {"dest": option.name, "help": option.help + default.replace("%", "%%"), "default": None}
    if not option.takes_value:
        return {**keywords, "action": "store_const", "const": "true"}
    keywords["metavar"] = option.kind.metavar
    if option.alone is not None:
        keywords |= {"nargs": "?", "const": option.alone}
    return {**keywords, "action": "append"} if option.kind.several else keywords


class _Version(argparse.Action):
    """Print the version. It is looked up only on request, because that is slow."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        parser.exit(message=f"ros2-mcp {version('ros2-mcp')}\n")


def settings_from(arguments: argparse.Namespace) -> Settings:
    """Return the settings of the environment, overridden by the command line's."""
    words: Mapping[str, str | list[str] | None] = vars(arguments)
    overrides: dict[str, Any] = {}
    for name, option in OPTIONS.items():
        word = words[name]
        if word is not None:
            overrides[name] = option.parse(word if isinstance(word, str) else option.kind.joined(word))
    return Settings.from_environment(os.environ, **overrides)
