"""Make the C library keep the memory of large messages for the next messages."""

import ctypes
import os
import sys

# Constants of malloc.h.
M_TRIM_THRESHOLD = -1
M_MMAP_THRESHOLD = -3
M_ARENA_MAX = -8
# The most freed memory to keep, and the size from which an allocation is returned at once. A raw full HD image is 6 MB,
# so several fit.
KEPT_BYTES = 32 * 1024 * 1024
# Each arena of glibc keeps that much, and by default there are eight per processor, so that many threads that once had
# an image would hold on to it. Python's threads take turns anyway; with two arenas no thread of the middleware waits
# for one.
MOST_ARENAS = 2


def keep_freed_memory() -> None:
    """Make glibc keep up to 32 MB of freed memory. No effect with another C library, or if the user's
    environment tunes malloc.

    By default glibc returns most of it at once, so that each copy of a large message costs 1,500 page faults: this was
    a third of the time to read an image (docs/explanation/speed.md).
    """
    if sys.platform != "linux" or any(name.startswith("MALLOC_") for name in os.environ):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # musl has none
        mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
        mallopt(M_ARENA_MAX, MOST_ARENAS)
