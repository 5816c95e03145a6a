"""Parameters outside the range stated in their description: no node checks this range."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Iterator

from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import Evidence
from ros2_mcp.ops.measure.findings import Finding
from ros2_mcp.ops.nodes.parameters import Parameter

_NUMBER = r"(?P<{}>[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[-+]?\d+)?)"
_UNIT = r"(?:\s*(?:m/s\^?2|m/s²|m/s|rad/s|rad|deg|°|mm|cm|m|s|ms|hz|%|kg|n|v|a))?"
_FROM, _TO = _NUMBER.format("low"), _NUMBER.format("high")
_TO_OR_AND = r"(?:and|to|\.\.+|…|–|,|;)"
_BOTH = (
    re.compile(rf"\b(?:between|from|in|range:?|within|limits?:?)\s*\[?\s*{_FROM}{_UNIT}\s*{_TO_OR_AND}\s*{_TO}", re.I),
    re.compile(rf"[\[(]\s*{_FROM}{_UNIT}\s*(?:,|;|\.\.+|…|–|to|-)\s*{_TO}{_UNIT}\s*[\])]", re.I),
    re.compile(rf"(?<![\w.]){_FROM}{_UNIT}\s*(?:\.\.+|…|–)\s*{_TO}(?![\w.])", re.I),
    re.compile(rf"(?<![\w.]){_FROM}\s*(?:<=|≤|<)\s*\w+\s*(?:<=|≤|<)\s*{_TO}", re.I),
)
_LESS, _MORE = r"(?:less|lower|smaller) than", r"(?:more|greater|larger|higher) than"
_AT_LEAST = rf"(?:at least|minimum(?: value)?(?: is| of|:)?|\bmin\.?:?|>=|≥|not (?:be )?{_LESS}|no {_LESS})"
_AT_MOST = rf"(?:at most|maximum(?: value)?(?: is| of|:)|\bmax\.?:|<=|≤|not exceed|not (?:be )?{_MORE}|no {_MORE})"
_LOWEST, _HIGHEST = re.compile(rf"{_AT_LEAST}\s*{_FROM}", re.I), re.compile(rf"{_AT_MOST}\s*{_TO}", re.I)
_ABOVE = re.compile(rf"(?:{_MORE}|(?<![-=<])>)\s*{_FROM}", re.I)
_BELOW = re.compile(rf"(?:{_LESS}|(?<![=>])<(?!=))\s*{_TO}", re.I)
_POSITIVE = re.compile(r"\b(?:must|should|has to|needs to) be (?:strictly )?(?P<not>non-?\s?)?(?:a )?positive\b", re.I)
_NEGATED = re.compile(r"\b(?:not|no|never)\s*$", re.I)
_MOST = 10
"""The most findings: a node whose parameters are in another unit has many."""


def _find(evidence: Evidence) -> Iterator[Finding]:
    count = 0
    for node, parameters in (evidence.parameters or {}).items():
        for one in parameters:
            if (bound := outside(one)) and count < _MOST:
                count += 1
                problem = (
                    f"{named(one.name)} is {one.value}, {bound} by its own description: {quoted(one.description)}."
                )
                yield Finding("warning", node, problem, "Set it within that range, or correct its description.", node)


def outside(parameter: Parameter) -> str:
    """Return how the value violates the range in its description, in words; empty if it does not, or no range is
    stated.
    """
    value, text = parameter.value, parameter.description
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not text or not math.isfinite(value):
        return ""
    for pattern in _BOTH:
        if (found := pattern.search(text)) and float(found["low"]) < float(found["high"]):
            is_outside = not float(found["low"]) <= value <= float(found["high"])
            return f"outside {found['low']} to {found['high']}" if is_outside else ""
    for pattern, group, is_outside, words in (
        (_LOWEST, "low", operator.lt, "below"),
        (_HIGHEST, "high", operator.gt, "above"),
        (_ABOVE, "low", operator.le, "not above"),
        (_BELOW, "high", operator.ge, "not below"),
    ):
        found = pattern.search(text)
        if found and not _NEGATED.search(text[: found.start()]) and is_outside(value, float(found[group])):
            return f"{words} {found[group]}"
    if (found := _POSITIVE.search(text)) and (value < 0 or (value == 0 and not found["not"])):
        return "not positive"
    return ""


CHECK = Check(("parameters",), _find)
