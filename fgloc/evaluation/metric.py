"""One number of a report, with all that is needed to read it."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from fgloc.errors import InputError

Better = Literal["lower", "higher", "target", "neither"]


@dataclass(frozen=True)
class Metric:
    """A value with its unit, direction, sample count and interval.

    value      None where the method or the truth cannot give it; `why` then says the reason
    unit       'm', 'rad', 's'; '1' for shares, counts and ratios
    better     which way is better; 'target' means near `target`, 'neither' only informs
    n          number of samples the value was computed from
    low, high  95 % interval of the value, None where there is none
    note       what a reader has to know, e.g. which covariance a consistency figure is about

    Raises InputError where the value is not finite, or is None without a `why`.
    """

    value: float | None
    unit: str
    better: Better = "lower"
    n: int = 0
    low: float | None = None
    high: float | None = None
    target: float | None = None
    why: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        if self.value is None and not self.why:
            raise InputError("a metric without a value must say why")
        if self.value is not None and not math.isfinite(self.value):
            raise InputError(
                f"a metric's value must be finite, not {self.value}; give None and why"
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: value, unit, better and n always, the rest where present."""
        always = {"value": self.value, "unit": self.unit, "better": self.better, "n": self.n}
        names = ("low", "high", "target", "why", "note")
        extra = {name: value for name in names if (value := getattr(self, name)) not in (None, "")}
        return always | extra
