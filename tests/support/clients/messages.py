"""Anthropic's Messages, as Claude Code speaks it: https://docs.claude.com/en/api/messages-streaming."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from support.clients.script import NamedCall, ShownResult, ShownTool, picture_and_text

_USAGE = {
    "input_tokens": 10,
    "output_tokens": 10,
    "cache_creation_input_tokens": 0,
    "cache_read_input_tokens": 0,
}


class Messages:
    """An `Interface`."""

    def tools(self, body: Mapping[str, Any]) -> list[ShownTool]:
        return [
            ShownTool(tool["name"], "", tool.get("description", ""), tool)
            for tool in body.get("tools", [])
            if "name" in tool
        ]

    def results(self, body: Mapping[str, Any]) -> dict[str, ShownResult]:
        blocks = [
            block
            for message in body.get("messages", [])
            if isinstance(message["content"], list)
            for block in message["content"]
            if block.get("type") == "tool_result"
        ]
        return {block["tool_use_id"]: _result(block) for block in blocks}

    def events(self, body: Mapping[str, Any], text: str, calls: Sequence[NamedCall]) -> list[dict[str, Any]]:
        message = {
            "id": "msg_scripted",
            "type": "message",
            "role": "assistant",
            "model": body.get("model", "scripted"),
            "content": [],
            "stop_reason": None,
            "stop_sequence": None,
            "usage": _USAGE,
        }
        events: list[dict[str, Any]] = [{"type": "message_start", "message": message}]
        blocks = [({"type": "text", "text": ""}, {"type": "text_delta", "text": text})] if text else []
        blocks += [
            (
                {"type": "tool_use", "id": call.call_id, "name": call.name, "input": {}},
                {"type": "input_json_delta", "partial_json": json.dumps(call.arguments)},
            )
            for call in calls
        ]
        for index, (block, delta) in enumerate(blocks):
            events += [
                {"type": "content_block_start", "index": index, "content_block": block},
                {"type": "content_block_delta", "index": index, "delta": delta},
                {"type": "content_block_stop", "index": index},
            ]
        end = {"stop_reason": "tool_use" if calls else "end_turn", "stop_sequence": None}
        return [
            *events,
            {"type": "message_delta", "delta": end, "usage": {"output_tokens": 10}},
            {"type": "message_stop"},
        ]


def _result(block: Mapping[str, Any]) -> ShownResult:
    text, pictures = picture_and_text(block.get("content", ""))
    return ShownResult(text, pictures, block.get("is_error", False))
