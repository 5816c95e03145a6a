"""Numeric fields of captures as arrays over time. Import it inside functions only, as `signals`: it needs NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ros2_mcp.codec.select import FieldPath
from ros2_mcp.model.errors import BadValue
from ros2_mcp.ops.measure.signals import Numbers, flat
from ros2_mcp.ops.sources.source import Capture


def seconds(capture: Capture) -> Numbers:
    """When each sample was received, in seconds from the capture's beginning; latched samples may be before it."""
    return flat([(sample.received_ns - capture.start_ns) / 1e9 for sample in capture.samples])


def value_of(field: FieldPath, message: object) -> Any:
    """The value of a field in a message; None where a list has no such element."""
    try:
        return field.value_in(message)
    except BadValue:
        return None


def present(field: FieldPath, messages: Sequence[object], times: Numbers) -> tuple[Numbers, list[Any]]:
    """The values of a field with their times, without messages that have none: no such element, or an empty list."""
    found = [(at, value_of(field, message)) for at, message in zip(times.tolist(), messages, strict=True)]
    found = [(at, value) for at, value in found if value is not None and (not field.is_list or len(value))]
    return flat([at for at, _ in found]), [value for _, value in found]
