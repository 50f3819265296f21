"""Portions of a long drive, worked on by all cores at a time.

Numpy gives way to other threads while it computes, so threads suffice. The portions and the order
in which their results are put together do not depend on how many there are: neither do the results.
"""

import os
from collections.abc import Callable, Iterable
from contextvars import copy_context
from typing import TypeVar

Portion = TypeVar("Portion")
Result = TypeVar("Result")


def on_all_cores(work: Callable[[Portion], Result], portions: Iterable[Portion]) -> list[Result]:
    """What the work makes of each portion, in their order, once all is done.

    Numpy's error state is that of the caller. Raises what the first portion that fails does.
    """
    from concurrent.futures import ThreadPoolExecutor

    cores, todo = os.cpu_count() or 1, list(portions)
    if cores == 1 or len(todo) < 2:
        return [work(portion) for portion in todo]
    with ThreadPoolExecutor(min(cores, len(todo))) as pool:
        running = [pool.submit(copy_context().run, work, portion) for portion in todo]
        return [future.result() for future in running]
