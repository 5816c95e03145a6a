"""Large arrays of the messages that a program reads. They stay in this process; the program gets a reference to each.

A reference is `{"$summary": "uint8[]", "length": 6220800, "held": 7}`. Functions of the module `robot` that compute on
arrays accept it in place of the array.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.values import SUMMARY

MOST_BYTES = 32_000_000
"""The most bytes held for one program: a picture of a 4K camera and a cloud, or five clouds of a large lidar."""
HELD = "held"
"""The key of the number in a reference."""


class Held:
    """The arrays held for one program. If there are too many, the oldest are dropped; the newest never is."""

    def __init__(self) -> None:
        self._kept: dict[int, tuple[Any, int]] = {}
        self._bytes = 0
        self._count = 0

    def hold(self, value: Any, size: int) -> int:
        """Hold a value of `size` bytes. Return the number with which `get` finds it."""
        self._count += 1
        self._kept[self._count] = value, size
        self._bytes += size
        while self._bytes > MOST_BYTES and len(self._kept) > 1:
            _, dropped = self._kept.pop(next(iter(self._kept)))
            self._bytes -= dropped
        return self._count

    def reference(self, array: Any, type_name: str) -> dict[str, Any]:
        """Hold a NumPy array. Return its reference, which the program gets."""
        return {SUMMARY: type_name, "length": len(array), HELD: self.hold(array, int(array.nbytes))}

    def get(self, value: Any) -> Any:
        """Return the array of a reference; any other value unchanged.

        Raises:
            BadInput: if the array is no longer held.
        """
        if not isinstance(value, Mapping) or HELD not in value:
            return cast("Any", value)
        number = cast("Mapping[str, Any]", value)[HELD]
        kept = self._kept.get(number) if isinstance(number, int) else None
        if kept is None:
            raise BadInput(
                "This array is no longer held.",
                f"The last {MOST_BYTES // 1_000_000} MB that a program reads are held: use a message before you read "
                "the next.",
            )
        return kept[0]
