"""Single keys of a terminal, as they are pressed."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

UP, DOWN = "\x1b[A", "\x1b[B"

if sys.platform == "win32":
    import msvcrt

    # Too short a delay to notice. Windows cannot wait for a key with a time-out.
    _POLL_S = 0.02
    _ARROWS = {"H": UP, "P": DOWN}
    """The character that follows the prefix of a special key."""
else:
    import select
    import termios
    import tty


class Restored(Protocol):
    """Returns a context in which lines can be typed, with the usual echo."""

    def __call__(self) -> AbstractContextManager[None]:
        """Return the context."""
        ...


def key(wait_s: float) -> str:
    """Return a key that was pressed within that time, or "". An arrow key is `UP` or `DOWN`."""
    if sys.platform == "win32":
        deadline = time.monotonic() + wait_s
        while not msvcrt.kbhit():
            if time.monotonic() >= deadline:
                return ""
            time.sleep(_POLL_S)
        pressed = msvcrt.getwch()
        return _ARROWS.get(msvcrt.getwch(), "") if pressed in ("\x00", "\xe0") else pressed
    ready, _, _ = select.select([sys.stdin], [], [], wait_s)
    return os.read(sys.stdin.fileno(), 8).decode(errors="replace") if ready else ""


@contextmanager
def single_keys() -> Generator[Restored, None, None]:
    """Within this context, each key arrives at once; yields a function for contexts in which lines can be typed."""
    if sys.platform == "win32":
        os.system("")  # pyright: ignore[reportDeprecated] - so that signs move the cursor

        @contextmanager
        def unchanged() -> Generator[None, None, None]:
            yield

        yield unchanged
        return
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)

    @contextmanager
    def restored() -> Generator[None, None, None]:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
        try:
            yield
        finally:
            tty.setcbreak(terminal)

    tty.setcbreak(terminal)
    try:
        yield restored
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
        sys.stdout.write("\r\n")
