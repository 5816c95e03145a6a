"""Cuts a resource's content to the size of an answer."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sized
from typing import Any, cast

from ros2_mcp.model.text import visible_json

Content = Mapping[str, Any]
"""The content of a resource: a JSON object."""

# Lists and texts up to this size stay whole while larger ones can be shortened.
_LEAST_BYTES = 200


def fitting(content: Content, max_bytes: int) -> str:
    """Return the content as JSON text of at most that size. `omitted` in it describes what was cut.

    The longest list or text is halved until all fits; other parts are dropped as a whole. Hidden characters are
    escaped.
    """
    content, text = visible_json(content)
    shown, omitted = dict(content), dict[str, str]()
    while len(text.encode()) > max_bytes:
        sizes = {part: _size(value) for part, value in shown.items()}
        divisible = [part for part, value in shown.items() if _is_divisible(value) and sizes[part] > _LEAST_BYTES]
        part = max(divisible or sizes, key=lambda part: sizes[part])
        value, whole = shown[part], content[part]
        if _is_divisible(value):
            shown[part] = value[: len(value) // 2]
            unit = "characters" if isinstance(value, str) else "entries"
            omitted[part] = f"the first {len(shown[part])} of {len(whole)} {unit} are shown"
        else:
            shown[part], omitted[part] = None, f"{_size(whole)} bytes"
        text = _text({**shown, "omitted": omitted})
    return text


def _is_divisible(value: Any) -> bool:
    return isinstance(value, (list, str)) and len(cast("Sized", value)) > 1


def _size(value: Any) -> int:
    return len(_text(value).encode())


def _text(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
