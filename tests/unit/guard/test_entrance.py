"""Where a server over HTTP listens, under which names, and that no combination of settings lets in strangers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.guard.entrance import NO_LOGIN, entrance_of, is_loopback, url_of, warnings_of
from ros2_mcp.guard.tokens import add_token
from ros2_mcp.model.errors import BadInput
from ros2_mcp.settings import Settings


@pytest.fixture(autouse=True)
def _state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def settings(**more: Any) -> Settings:
    return replace(Settings(transport="streamable-http"), **more)


@pytest.mark.parametrize(
    ("host", "is_local"),
    [
        ("127.0.0.1", True),
        ("127.9.9.9", True),
        ("::1", True),
        ("[::1]", True),
        ("localhost", True),
        ("LOCALHOST", True),
        ("0.0.0.0", False),
        ("::", False),
        ("", False),
        ("192.168.1.4", False),
        ("10.0.0.1", False),
        ("robot.local", False),
        ("localhost.robot.example", False),
        ("127.0.0.1.robot.example", False),
        ("::ffff:10.0.0.1", False),
    ],
)
def test_what_is_reached_from_other_machines_is_told_from_what_is_not(host: str, is_local: bool) -> None:
    assert is_loopback(host) is is_local
    if is_local:
        assert entrance_of(settings(host=host)).tokens
        assert entrance_of(settings(host=host, no_login=True)).tokens is None
        return
    for bare in ({}, {"no_login": True}, {"tls_cert": Path("/"), "tls_key": Path("/"), "no_login": True}):
        with pytest.raises(BadInput):
            entrance_of(settings(host=host, **bare))
    for safe in ({"tls_cert": Path("/"), "tls_key": Path("/")}, {"behind_proxy": True}):
        assert entrance_of(settings(host=host, **safe)).tokens


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"tls_cert": Path("/")}, "belong together"),
        ({"tls_key": Path("/")}, "belong together"),
        ({"no_login": True, "behind_proxy": True}, "--no-login would give access to anyone"),
        ({"no_login": True, "public_url": "https://robot.example"}, "--no-login would give access to anyone"),
        ({"no_login": True, "token_file": Path("/tokens")}, "contradict"),
        ({"socket": Path("/run/s")}, "contradict"),
        ({"token_file": Path("/nowhere/tokens")}, "cannot be read"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(more: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        entrance_of(settings(**more))


def test_the_own_token_is_told_once_with_what_configures_a_client(tmp_path: Path) -> None:
    first, second = entrance_of(settings()), entrance_of(settings())
    token = (tmp_path / "state/ros2-mcp/http-token").read_text().strip()
    assert f"Authorization: Bearer {token}" in first.told and "ros2-mcp config CLIENT --http" in first.told
    assert token not in second.told and "http-token" in second.told
    elsewhere = entrance_of(settings(port=9000, public_url="https://robot.example"))
    assert "ros2-mcp --port 9000 --public-url https://robot.example config CLIENT --http" in elsewhere.told


@pytest.mark.parametrize("host", ["0.0.0.0", "[::]"])
def test_who_listens_everywhere_without_a_public_address_is_told_that_nobody_from_elsewhere_comes_in(host: str) -> None:
    everywhere = settings(host=host, behind_proxy=True)
    assert "until --public-url says" in entrance_of(everywhere).told
    assert "refused (421)" not in entrance_of(replace(everywhere, public_url="https://robot.example")).told


def test_a_file_of_tokens_stands_in_the_place_of_the_own_one(tmp_path: Path) -> None:
    token = add_token(tmp_path / "tokens", "cell", ["observe"])
    entrance = entrance_of(settings(token_file=tmp_path / "tokens"))
    assert entrance.tokens and entrance.tokens.login(token.encode())
    assert not (tmp_path / "state").exists()


def test_without_a_login_it_says_so_wherever_somebody_looks() -> None:
    assert NO_LOGIN in entrance_of(settings(no_login=True)).told
    assert warnings_of(settings(no_login=True)) == [NO_LOGIN]
    assert warnings_of(settings()) == warnings_of(Settings(no_login=True)) == []  # stdio asks nobody


@pytest.mark.parametrize(
    ("more", "url", "hosts", "origins"),
    [
        ({}, "http://127.0.0.1:8123/mcp", {"localhost:8123"}, {"http://localhost:8123"}),
        (
            {"public_url": "https://Robot.example", "behind_proxy": True},
            "https://Robot.example/mcp",
            {"robot.example", "robot.example:443", "localhost:8123"},
            {"https://robot.example", "https://robot.example:443"},
        ),
        (
            {"public_url": "https://robot.example:8443/arm/mcp"},
            "https://robot.example:8443/arm/mcp",
            {"robot.example:8443"},
            {"https://robot.example:8443"},
        ),
        (
            {"host": "robot.local", "tls_cert": Path("/"), "tls_key": Path("/"), "port": 443},
            "https://robot.local:443/mcp",
            {"robot.local", "robot.local:443"},
            {"https://robot.local"},
        ),
        ({"public_url": "http://[fe80::1]:80"}, "http://[fe80::1]:80/mcp", {"[fe80::1]"}, {"http://[fe80::1]"}),
    ],
)
def test_the_public_address_is_accepted_as_host_and_origin(
    more: dict[str, Any], url: str, hosts: set[str], origins: set[str]
) -> None:
    entrance = entrance_of(settings(**more))
    assert entrance.url == url_of(settings(**more)) == url
    assert hosts <= set(entrance.hosts) and origins <= set(entrance.origins)
    assert not {"robot.example:8443", "http://robot.example"} & (set(entrance.hosts) | set(entrance.origins)) - hosts


@pytest.mark.parametrize(
    "url",
    ["robot.example", "ftp://robot.example", "https://", "https://a@b", "https://a?b", "https://a\nb", "https://a:0"],
)
def test_a_public_url_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(BadInput, match="--public-url"):
        Settings.from_environment({}, public_url=url)
