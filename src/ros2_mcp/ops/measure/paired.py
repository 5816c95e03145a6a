"""The columns of a topic that is compared with another one, message by message.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any

from ros2_mcp.model.samples import Sample, header_stamp_ns
from ros2_mcp.ops.measure.columns import Columns

_STAMP_END = 12
"""A message that begins with a header has its stamp in bytes 4 to 11, after the header of CDR."""


class Paired(Columns):
    """Columns with the stamp of each row, and a mark that equal messages have in common (a hash of 64 bits)."""

    def __init__(self, codec: Any, type_name: str, *more: Any, **options: Any) -> None:
        super().__init__(codec, type_name, *more, **options)
        self.marks = array("q")
        self._stamps = array("q") if codec.definitions.starts_with_header(type_name) else None

    @property
    def rows(self) -> int:
        """How many messages can be compared."""
        return len(self.marks)

    @property
    def stamps_ns(self) -> Sequence[int] | None:
        """The header's stamp of each row; None where the type does not begin with a header."""
        return self._stamps

    def keep(self, samples: Sequence[Sample]) -> None:
        """Keeps stamps and marks."""
        self.marks.extend(hash(sample.data) for sample in samples)
        if self._stamps is not None:
            self._stamps.extend(
                header_stamp_ns(sample.data) if len(sample.data) >= _STAMP_END else 0 for sample in samples
            )
