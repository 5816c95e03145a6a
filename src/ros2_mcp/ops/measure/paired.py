"""Columns of a topic that is compared with another topic message by message.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ros2_mcp.model.samples import STAMP_END, Sample, header_stamp_ns
from ros2_mcp.ops.measure.columns import Columns

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.flow import Times


class Paired(Columns):
    """Columns with the stamp and a 64-bit hash (`marks`) of each row; equal messages have equal hashes."""

    def __init__(self, codec: Any, type_name: str, *more: Any, **options: Any) -> None:
        super().__init__(codec, type_name, *more, **options)
        self._marks = array("q")
        self._stamps = array("q") if codec.definitions.starts_with_header(type_name) else None

    @property
    def rows(self) -> int:
        """The number of rows, i.e. of messages that can be compared."""
        return len(self._marks)

    @property
    def marks(self) -> Times:
        """A hash for each row; equal messages have equal hashes."""
        return np.frombuffer(self._marks, np.int64) if self._marks else np.zeros(0, np.int64)

    @property
    def stamps_ns(self) -> Times | None:
        """The header stamp of each row in ns; None if the type does not begin with a header."""
        if self._stamps is None:
            return None
        return np.frombuffer(self._stamps, np.int64) if self._stamps else np.zeros(0, np.int64)

    def keep(self, samples: Sequence[Sample]) -> None:
        """Keep the stamp and the hash of each message."""
        self._marks.extend(hash(sample.data) for sample in samples)
        if self._stamps is not None:
            self._stamps.extend(
                header_stamp_ns(sample.data) if len(sample.data) >= STAMP_END else 0 for sample in samples
            )
