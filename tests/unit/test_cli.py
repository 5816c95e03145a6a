from __future__ import annotations

from pathlib import Path

import pytest

from ros2_mcp.cli import CLIENTS, parser, run, settings_from
from ros2_mcp.commands.call import parse_assignments
from ros2_mcp.commands.doctor import what_is_set
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


def test_options_become_settings() -> None:
    made = settings("--read-only", "--domain-id", "7", "--workspace", "/a", "--workspace", "/b", "--tools", "core,x")
    assert (made.read_only, made.domain_id) == (True, 7)
    assert tuple(made.workspaces) == (Path("/a"), Path("/b"))
    assert tuple(made.tools) == ("core", "x")


def test_every_setting_has_an_option_that_sets_it() -> None:
    texts = {"transport": "sse", "log_level": "info", "bag": "/", "result_bytes": "1000", "black_box_bytes": "1000000"}
    for name, option in OPTIONS.items():
        text = texts.get(name, "true" if option.default is False else "1")
        made = settings(option.flag, *([text] if option.takes_value else []))
        assert getattr(made, name) == option.parse(text)
        assert made.origins == {name: option.flag}


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
        (["call", "ros2_topic_list", "scan"], "'scan' is not an assignment. Write key=value"),
    ],
)
def test_a_wrong_argument_ends_with_one_line_on_stderr(
    argv: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(argv) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"ros2-mcp: {told}") and err.count("\n") == 1


def test_an_unknown_client_is_refused_with_those_that_are_known(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["config", "emacs"])
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert all(client in told for client in CLIENTS)


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("limit=3", 3),
        ("duration=0.5", 0.5),
        ("include_hidden=true", True),
        ('fields=["pose", "twist"]', ["pose", "twist"]),
        ('data={"linear": {"x": 0.1}}', {"linear": {"x": 0.1}}),
        ("topic_name=/scan", "/scan"),
        ('topic_name="/scan"', "/scan"),
        ("pattern=a=b", "a=b"),
        ("pattern=", ""),
    ],
)
def test_a_value_that_is_json_is_taken_as_json_and_any_other_as_text(word: str, value: object) -> None:
    assert list(parse_assignments([word]).values()) == [value]


def test_assignments_keep_their_names() -> None:
    assert parse_assignments(["a=1", "b=x"]) == {"a": 1, "b": "x"}


def test_a_word_that_assigns_nothing_is_refused() -> None:
    with pytest.raises(BadInput, match="key=value"):
        parse_assignments(["a=1", "scan"])
