"""What a client sends is read, or refused, the same way whether it is large or small."""

from __future__ import annotations

import pytest
from mcp.types import JSONRPCNotification

from ros2_mcp.mcp.transports.jsonrpc import Refusal, read_message
from ros2_mcp.mcp.transports.stdio import _as_line  # pyright: ignore[reportPrivateUsage] - what no good client can cause

LARGE = b" " * 25_000
PING = b'{"jsonrpc": "2.0", "id": 1, "method": "ping", "params": {"_meta": {"progressToken": "%b"}}}'


@pytest.mark.parametrize("text", [b"\\ud83d\\ude00", b"\\\\ud83d", b"\\\\\\\\udc00", b"\xf0\x9f\x98\x80"])
@pytest.mark.parametrize("padding", [b"", LARGE], ids=["small", "large"])
def test_text_of_any_character_is_read(text: bytes, padding: bytes) -> None:
    assert read_message(padding + PING % text) == read_message(PING % text)
    assert not isinstance(read_message(PING % text), list)


@pytest.mark.parametrize("text", [b"\\ud800", b"\\udc00\\ud800", b"\\ud83dx\\ude00", b"\\\\\\udc00", b"\xed\xa0\x80"])
@pytest.mark.parametrize("padding", [b"", LARGE], ids=["small", "large"])
def test_half_a_surrogate_pair_is_refused_with_the_id_of_its_request(text: bytes, padding: bytes) -> None:
    refusals = read_message(padding + PING % text)
    assert isinstance(refusals, list)
    assert [(one.id, one.code) for one in refusals] == [(1, -32600)]


@pytest.mark.parametrize("padding", ["", " " * 25_000], ids=["small", "large"])
def test_what_is_not_utf_8_is_refused(padding: str) -> None:
    refusals = read_message((padding + '{"jsonrpc": "2.0", "id": 1, "method": "ping"}').encode("utf-16"))
    assert [type(one) for one in refusals] == [Refusal]


def test_a_notification_that_cannot_be_written_is_left_out() -> None:
    assert not _as_line(JSONRPCNotification(jsonrpc="2.0", method="x", params={"progressToken": "\ud800"}))
