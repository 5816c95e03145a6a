"""How the C library keeps the memory of large messages for the next ones."""

import ctypes
import os
import sys

# Numbers of malloc.h.
M_TRIM_THRESHOLD = -1
M_MMAP_THRESHOLD = -3
M_ARENA_MAX = -8
# A raw picture is 6 MB at full HD. Chosen: several fit, and after the last one no more than this is held without need.
KEPT_BYTES = 32 * 1024 * 1024
# Each pool of memory keeps so much, and glibc has eight for each processor: that many threads which have once had a
# picture hold on to it. Python's threads take turns anyway; of two pools a thread of the middleware waits for neither.
MOST_ARENAS = 2


def keep_freed_memory() -> None:
    """Have freed memory kept up to 32 MB, where the C library is glibc and the user's environment does not tune it.

    By itself it gives most of it back at once, so that each copy of a large message is 1,500 page faults: that was a
    third of the time of a picture that is read (docs/explanation/speed.md).
    """
    if sys.platform != "linux" or any(name.startswith("MALLOC_") for name in os.environ):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # musl has none
        mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
        mallopt(M_ARENA_MAX, MOST_ARENAS)
