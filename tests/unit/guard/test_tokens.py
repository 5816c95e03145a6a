"""Tokens: made once, kept for their user alone, compared by their SHA-256, each with what it may do."""

from __future__ import annotations

import hashlib
import os
import threading
from pathlib import Path

import pytest

from ros2_mcp.guard.tokens import OWN_NAME, SCOPES, add_token, may, own_token, own_tokens, read_tokens
from ros2_mcp.model.errors import BadInput


@pytest.mark.promise("README", "The server makes the token itself")
def test_the_own_token_is_made_once_for_its_user_alone(tmp_path: Path) -> None:
    folder = tmp_path / "deep/state"
    token, is_new = own_token(folder)
    assert is_new and len(token) >= 43  # 256 bits
    assert own_token(folder) == (token, False)
    assert (folder / "http-token").stat().st_mode & 0o777 == 0o600
    assert folder.stat().st_mode & 0o777 == 0o700
    assert [path.name for path in folder.iterdir()] == ["http-token"]


def test_servers_that_start_at_the_same_time_agree_on_one_token(tmp_path: Path) -> None:
    made: list[tuple[str, bool]] = []
    threads = [threading.Thread(target=lambda: made.append(own_token(tmp_path))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({token for token, _ in made}) == 1 and sum(is_new for _, is_new in made) == 1


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o660, 0o602])
def test_an_own_token_that_others_can_read_or_change_is_not_used(tmp_path: Path, mode: int) -> None:
    own_token(tmp_path)
    (tmp_path / "http-token").chmod(mode)
    with pytest.raises(BadInput, match="chmod 600"):
        own_token(tmp_path)


def test_an_own_token_that_is_a_link_or_empty_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_text("x" * 50)
    (tmp_path / "http-token").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(BadInput, match="cannot be kept"):
        own_token(tmp_path)
    (tmp_path / "http-token").unlink()
    os.close(os.open(tmp_path / "http-token", os.O_CREAT, 0o600))
    with pytest.raises(BadInput, match="holds no token"):
        own_token(tmp_path)


def test_the_own_token_may_everything_and_another_one_nothing(tmp_path: Path) -> None:
    token, _ = own_token(tmp_path)
    login = own_tokens(tmp_path).login(token.encode())
    assert login and login.name == OWN_NAME and login.scopes == set(SCOPES)
    for wrong in (token[:-1], token + "x", token.swapcase(), "", "x", hashlib.sha256(token.encode()).hexdigest()):
        assert own_tokens(tmp_path).login(wrong.encode()) is None


def test_an_added_token_is_found_by_what_was_printed_and_is_nowhere_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    first, second = add_token(path, "cell-3", ["observe", "stop"]), add_token(path, "panel", ["stop"])
    assert path.stat().st_mode & 0o777 == 0o600
    text = path.read_text()
    assert first not in text and second not in text and text.startswith("# ")
    tokens = read_tokens(path)
    found = [tokens.login(token.encode()) for token in (first, second)]
    assert [(login.name, login.scopes) for login in found if login] == [
        ("cell-3", {"observe", "stop"}),
        ("panel", {"stop"}),
    ]
    with pytest.raises(BadInput, match="has a token panel already"):
        add_token(path, "panel", ["stop"])


def test_a_token_is_added_behind_a_last_line_that_a_person_did_not_end(tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    first = add_token(path, "cell", ["act"])
    path.write_text(path.read_text().rstrip("\n"))
    second = add_token(path, "panel", ["stop"])
    tokens = read_tokens(path)
    assert tokens.login(first.encode()) and tokens.login(second.encode())


DIGEST = "sha256:" + "0" * 64


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("cell observe", "line 2: 'cell observe' is not a token"),
        (f"cell observe {DIGEST} more", "line 2"),
        (f"the/cell observe {DIGEST}", "line 2"),
        (f"cell obsreve {DIGEST}", "Did you mean observe"),
        (f"cell observe, {DIGEST}", "no scope ''"),
        ("cell observe in-the-open", "line 2: The token of cell is not kept as sha256"),
        (f"cell observe {DIGEST.upper()}", "line 2"),
        (f"cell act {DIGEST}\nother act {DIGEST}", "line 3: other or its token occurs twice"),
        (f"cell act {DIGEST}\ncell act {DIGEST[:-1]}1", "line 3: cell or its token occurs twice"),
        ("", "has no token"),
    ],
)
def test_a_line_that_is_no_token_is_named_with_its_number(tmp_path: Path, line: str, said: str) -> None:
    path = tmp_path / "tokens"
    path.write_text(f"# tokens\n{line}\n")
    path.chmod(0o600)
    with pytest.raises(BadInput, match=said):
        read_tokens(path)


@pytest.mark.parametrize("mode", [0o620, 0o606, 0o666])
def test_a_file_of_tokens_that_others_can_change_is_not_used(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "tokens"
    add_token(path, "cell", ["act"])
    path.chmod(mode)
    with pytest.raises(BadInput, match="can be changed by others"):
        read_tokens(path)


@pytest.mark.parametrize(
    ("scopes", "risks"),
    [
        ({"observe"}, {"read"}),
        ({"act"}, {"write", "actuate", "stop"}),
        ({"stop"}, {"stop"}),
        ({"observe", "stop"}, {"read", "stop"}),
        ({"observe", "act", "stop"}, {"read", "write", "actuate", "stop"}),
        (set[str](), set[str]()),
    ],
)
def test_scopes_allow_what_their_names_say(scopes: set[str], risks: set[str]) -> None:
    assert {risk for risk in ("read", "write", "actuate", "stop") if not may(frozenset(scopes), risk)} == risks
