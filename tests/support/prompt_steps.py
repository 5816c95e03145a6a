"""The steps of a prompt as a model would take them: the calls it names, with their arguments."""

from __future__ import annotations

import json
import re
from typing import Any

CALL = re.compile(r"\bCall (ros2_\w+) with\s+(?=\{)")


def steps_of(text: str, **numbers: float) -> list[tuple[str, dict[str, Any]]]:
    """Every call of a prompt's text; words that the reader shall replace are replaced by `numbers`."""
    for word, number in numbers.items():
        text = text.replace(word, repr(number))
    found = [(match[1], match.end()) for match in CALL.finditer(text)]
    return [(tool, json.JSONDecoder().raw_decode(text, start)[0]) for tool, start in found]
