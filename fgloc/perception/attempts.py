"""What is tried and may fail: frames that cannot be read are counted; seconds by the stage."""

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from fgloc.errors import DriveError

T = TypeVar("T")


class Account:
    """What was dropped by the reason, what is to be said, processor seconds by the stage."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        self.remarks: list[str] = []
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def tried(self, sensor: str, load: Callable[[], T]) -> T | None:
        """A frame, or None where it cannot be read; the first reason of each sensor is told."""
        try:
            with self.stage("reading"):
                return load()
        except DriveError as err:
            reason = f"{sensor}: frames that cannot be read"
            if not self.dropped[reason]:
                self.remarks.append(f"{sensor}: the first frame that cannot be read: {err}")
            self.dropped[reason] += 1
            return None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Seconds of the processor go to a stage."""
        start_s = time.process_time()
        try:
            yield
        finally:
            self.seconds[name] += time.process_time() - start_s
