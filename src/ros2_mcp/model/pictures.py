"""Pictures as they travel to the model."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Picture:
    """An encoded picture; `note` says what it shows and what was done to it, in words."""

    data: bytes
    mime: str
    width: int
    height: int
    note: str
