"""The same work on many parts, on several processors.

Threads: numpy and Arrow let go of Python's lock while they compute. Parts should be large, some
10 ms each and of calls of 0.1 ms, or waiting for the lock takes what they gain.
"""

import os
from collections.abc import Callable, Iterable
from contextvars import copy_context
from typing import TypeVar

Part = TypeVar("Part")
Made = TypeVar("Made")

MOST_THREADS = 8


def each(make: Callable[[Part], Made], parts: Iterable[Part]) -> list[Made]:
    """What is made of each part, in their order; raises what the first that fails raises.

    The parts must not write to the same memory.
    """
    parts = list(parts)
    threads = min(processors(), MOST_THREADS, len(parts))
    if threads < 2:
        return [make(part) for part in parts]
    from concurrent.futures import ThreadPoolExecutor

    contexts = [copy_context() for _ in parts]  # of numpy's `errstate`, for one
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda context, part: context.run(make, part), contexts, parts))


def portions(n: int, size: int) -> list[slice]:
    """n rows in portions of so many, the last of what is left."""
    return [slice(first, first + size) for first in range(0, n, size)]


def processors() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
