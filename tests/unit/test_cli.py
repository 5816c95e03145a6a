from __future__ import annotations

from pathlib import Path

import pytest

from ros2_mcp.cli import CLIENTS, _options_first, parser, run, settings_from
from ros2_mcp.commands.doctor import policy_in_force, what_is_set
from ros2_mcp.model.errors import BadInput
from ros2_mcp.settings import OPTIONS, Settings


def settings(*argv: str) -> Settings:
    return settings_from(parser().parse_args(argv))


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS2_MCP_READONLY", "ROS2_MCP_PORT", "ROS2_MCP_TOOLS"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_command_it_serves() -> None:
    assert parser().parse_args([]).verb is None


@pytest.mark.promise("README", "ros2-mcp --help lists all options")
def test_the_help_lists_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parser().parse_args(["--help"])
    told = capsys.readouterr().out
    assert [option.flag for option in OPTIONS.values() if option.flag not in told] == []


def test_options_become_settings() -> None:
    made = settings("--read-only", "--domain-id", "7", "--workspace", "/a", "--workspace", "/b", "--tools", "core,x")
    assert (made.read_only, made.domain_id) == (True, 7)
    assert tuple(made.workspaces) == (Path("/a"), Path("/b"))
    assert tuple(made.tools) == ("core", "x")


def test_every_setting_has_an_option_that_sets_it() -> None:
    texts = {"transport": "streamable-http", "log_level": "info", "result_bytes": "1000", "black_box_bytes": "1000000"}
    texts |= {"bag": "/", "tls_cert": "/", "tls_key": "/", "public_url": "https://robot.example"}
    texts |= {"robots": "ssh://me@robot", "robot_env": "A=b"}
    for name, option in OPTIONS.items():
        text = texts.get(name, "true" if option.default is False else "1")
        made = settings(option.flag, *([text] if option.takes_value else []))
        assert getattr(made, name) == option.parse(text)
        assert made.origins == {name: option.flag}


def test_what_is_about_the_robot_may_stand_behind_the_command() -> None:
    assert settings("doctor", "--robot", "ssh://me@robot").robot.host == "robot"
    assert settings("--robot", "ssh://a", "config", "zed", "--domain-id", "3").domain_id == 3
    assert settings("--domain-id", "3", "doctor").domain_id == 3


def test_options_for_ssh_are_handed_on_word_by_word() -> None:
    made = settings("--ssh-option=-F", "--ssh-option=/a b/config", "--ssh-option=-oProxyJump=gate")
    assert made.ssh_options == ("-F", "/a b/config", "-oProxyJump=gate")


def test_variables_for_the_robot_are_names_and_values() -> None:
    made = settings("--robot-env", "A=b c", "--robot-env", "CYCLONEDDS_URI=file:///x=y")
    assert made.robot_env == ("A=b c", "CYCLONEDDS_URI=file:///x=y")
    for wrong in ("A", "=b", "1A=b", "A B=c"):
        with pytest.raises(BadInput, match="variables as NAME=VALUE"):
            settings("--robot-env", wrong)


def test_options_that_may_stand_alone_say_what_they_mean() -> None:
    assert settings("--black-box").black_box == ()
    assert settings("--black-box", "/odom,/scan").black_box == ("/odom", "/scan")
    assert settings("--custom-prompts").custom_prompts is True
    assert settings("--custom-prompts", "false").custom_prompts is False


def test_a_wrong_value_of_an_option_is_told_as_that_of_its_variable_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["--port", "many", "doctor"]) == 1
    of_option = capsys.readouterr().err
    monkeypatch.setenv("ROS2_MCP_PORT", "many")
    assert run(["doctor"]) == 1
    assert capsys.readouterr().err == of_option
    assert of_option == "ros2-mcp: --port (ROS2_MCP_PORT) is 'many'. It must be a whole number from 1 to 65535.\n"


def test_the_doctor_says_what_is_set_and_by_what_and_names_misspelt_variables() -> None:
    env = {"ROS2_MCP_PORT": "9000", "ROS2_MCP_READ_ONLY": "1"}
    made = Settings.from_environment(env, domain_id=7)
    told = [(finding.title, finding.detail, finding.fix) for finding in what_is_set(made, env)]
    assert told == [
        ("Setting --domain-id", "7 (DDS domain)", ""),
        ("Setting ROS2_MCP_PORT", "9000 (port for HTTP)", ""),
        (
            "ROS2_MCP_READ_ONLY",
            "is set, but is none of this server's variables",
            "Did you mean ROS2_MCP_READONLY?",
        ),
    ]


def test_the_doctor_says_which_policy_is_in_force_and_what_is_wrong_with_it(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    assert policy_in_force(Settings()).ok is None
    path, other = tmp_path / "hall.yaml", tmp_path / "wrong.yaml"
    path.write_text("policy: 1\nmode: confirm\n")
    other.write_text("policy: 1\nmode: confrim\n")
    path.chmod(0o600)
    other.chmod(0o600)
    found = policy_in_force(Settings(policy=(str(path),)))
    assert found.ok is True
    assert f"hall ({path}), mode confirm" in found.detail
    wrong = policy_in_force(Settings(policy=(str(other),)))
    assert (wrong.ok, wrong.fix) == (False, "Did you mean confirm?")
    assert wrong.detail == f"{other}, line 2: mode cannot be 'confrim'."


def test_an_option_wins_over_a_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    monkeypatch.setenv("ROS2_MCP_PORT", "9000")
    assert settings("--domain-id", "7").domain_id == 7
    assert settings().domain_id == 5
    assert settings().port == 9000


def test_a_variable_is_not_undone_by_an_option_that_was_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS2_MCP_READONLY", "1")
    assert settings().read_only is True


@pytest.mark.parametrize("level", ["debug", "info", "warning", "error"])
def test_every_log_level_that_is_offered_is_accepted(level: str) -> None:
    assert settings("--log-level", level).log_level == level


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["--domain-id", "233", "doctor"], "--domain-id (ROS_DOMAIN_ID) is 233"),
        (["--port", "0", "serve"], "--port (ROS2_MCP_PORT) is 0"),
    ],
)
def test_a_wrong_argument_ends_with_one_line_on_stderr(
    argv: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(argv) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"ros2-mcp: {told}") and err.count("\n") == 1


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["cal"], "There is no command 'cal'. Did you mean call?"),
        (["config", "claude"], "There is no client 'claude'. Did you mean claude-code or claude-desktop?"),
    ],
)
def test_a_misspelt_word_gets_the_nearest_names(argv: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(argv)
    assert ended.value.code == 2
    assert told in capsys.readouterr().err


def test_an_unknown_client_is_refused_with_those_that_are_known(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["config", "emacs"])
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert all(client in told for client in CLIENTS)


@pytest.mark.parametrize("robot", [["--robot", "ssh://me@robot"], ["--robot=ssh://me@robot"]])
def test_call_takes_what_is_about_the_robot_wherever_it_stands(robot: list[str]) -> None:
    for words in (
        ["call", *robot, "a_tool", "x=1"],
        ["call", "a_tool", *robot, "x=1"],
        ["call", "a_tool", "x=1", *robot],
    ):
        arguments = parser().parse_args(_options_first(words))
        assert settings_from(arguments).robot.host == "robot"
        assert (arguments.tool, arguments.arguments) == ("a_tool", ["x=1"])


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (
            ["call", "a_tool", "--policy", "nav", "x=1"],
            "--policy has to stand before the command: ros2-mcp --policy … call …",
        ),
        (["doctor", "--port=9000"], "--port has to stand before the command: ros2-mcp --port … doctor …"),
        (["doctor", "--nonsense"], "--nonsense is not taken here: ros2-mcp doctor --help lists what is."),
    ],
)
def test_an_option_in_the_wrong_place_is_named_in_one_line(
    argv: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        run(argv)
    assert (ended.value.code, capsys.readouterr().err) == (2, f"ros2-mcp: {told}\n")
