"""OpenAI's Responses, as Codex speaks it: https://platform.openai.com/docs/api-reference/responses-streaming."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from support.clients.script import NamedCall, ShownResult, ShownTool, picture_and_text

_USAGE = {
    "input_tokens": 10,
    "output_tokens": 10,
    "total_tokens": 20,
    "input_tokens_details": {"cached_tokens": 0},
    "output_tokens_details": {"reasoning_tokens": 0},
}


class Responses:
    """An `Interface`."""

    def tools(self, body: Mapping[str, Any]) -> list[ShownTool]:
        return [shown for tool in body.get("tools", []) for shown in _tools(tool)]

    def results(self, body: Mapping[str, Any]) -> dict[str, ShownResult]:
        outputs = [item for item in body.get("input", []) if item.get("type") == "function_call_output"]
        return {item["call_id"]: ShownResult(*picture_and_text(item["output"]), False) for item in outputs}

    def events(self, body: Mapping[str, Any], text: str, calls: Sequence[NamedCall]) -> list[dict[str, Any]]:
        items: list[dict[str, Any]] = []
        if text:
            said = {"type": "output_text", "text": text, "annotations": []}
            items.append({"type": "message", "role": "assistant", "id": "msg_scripted", "content": [said]})
        for call in calls:
            named = {"name": call.name, **({"namespace": call.namespace} if call.namespace else {})}
            arguments = json.dumps(call.arguments)
            items.append(
                {"type": "function_call", "id": f"fc_{call.call_id}", "call_id": call.call_id, "arguments": arguments}
                | named
            )
        response = {
            "id": "resp_scripted",
            "object": "response",
            "created_at": 0,
            "model": body.get("model", "scripted"),
            "output": [{**item, "status": "completed"} for item in items],
            "status": "completed",
            "usage": _USAGE,
        }
        events: list[dict[str, Any]] = [
            {"type": "response.created", "response": {**response, "status": "in_progress", "output": []}}
        ]
        for index, item in enumerate(items):
            for state, status in (("added", "in_progress"), ("done", "completed")):
                whole = {**item, "status": status}
                events.append({"type": f"response.output_item.{state}", "output_index": index, "item": whole})
        events.append({"type": "response.completed", "response": response})
        return [{**event, "sequence_number": number} for number, event in enumerate(events)]


def _tools(tool: Mapping[str, Any]) -> list[ShownTool]:
    """The functions of an entry; a namespace has several."""
    space = tool["name"] if tool.get("type") == "namespace" else ""
    functions = tool["tools"] if space else [tool]
    return [
        ShownTool(function["name"], space, function.get("description", ""), function)
        for function in functions
        if "name" in function
    ]
