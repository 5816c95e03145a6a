"""The one error of this package."""

from __future__ import annotations


class BuildError(Exception):
    """An interface package cannot be built.

    `message` is the reason and its place; `hint` says how to fix it, and may be empty.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
