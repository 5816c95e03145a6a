"""A resource's content as text that fits into an answer."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sized
from typing import Any, cast

from ros2_mcp.model.text import visible_json

Content = Mapping[str, Any]
"""What a resource says: a JSON object."""

# Of a list or text that is worth shortening; a shorter one is kept, and something else is left out.
_LEAST_BYTES = 200


def fitting(content: Content, max_bytes: int) -> str:
    """The content as JSON text of at most that size; what is left out is said under `left_out`.

    The longest list or text is halved until all fits; other parts are left out as a whole. Nothing in it is hidden.
    """
    content, text = visible_json(content)
    shown, left_out = dict(content), dict[str, str]()
    while len(text.encode()) > max_bytes:
        sizes = {part: _size(value) for part, value in shown.items()}
        divisible = [part for part, value in shown.items() if _is_divisible(value) and sizes[part] > _LEAST_BYTES]
        part = max(divisible or sizes, key=lambda part: sizes[part])
        value, whole = shown[part], content[part]
        if _is_divisible(value):
            shown[part] = value[: len(value) // 2]
            unit = "characters" if isinstance(value, str) else "entries"
            left_out[part] = f"the first {len(shown[part])} of {len(whole)} {unit} are shown"
        else:
            shown[part], left_out[part] = None, f"{_size(whole)} bytes"
        text = _text({**shown, "left_out": left_out})
    return text


def _is_divisible(value: Any) -> bool:
    return isinstance(value, (list, str)) and len(cast("Sized", value)) > 1


def _size(value: Any) -> int:
    return len(_text(value).encode())


def _text(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
