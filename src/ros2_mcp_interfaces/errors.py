"""The one error of this package."""

from __future__ import annotations


class BuildError(Exception):
    """An interface package cannot be built.

    `message` says what is wrong and where; `hint` says what to do about it and may be empty.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
