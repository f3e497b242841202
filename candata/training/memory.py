"""Memory that a step frees is kept for the next one."""

from __future__ import annotations

import ctypes

#: Parameters of glibc's `mallopt`. Source: malloc.h; mallopt(3).
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
#: Blocks up to this size come from the heap, which is never trimmed below it [bytes]: the largest that glibc takes.
_KEPT_BYTES = 2**31 - 1


def keep_freed_memory() -> None:
    """Let this process keep freed memory, as each training step takes the same again; only glibc is told.

    By default the C library returns some of it after each step, and the system clears thousands of pages for the next.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
    mallopt(_MMAP_THRESHOLD, _KEPT_BYTES)
