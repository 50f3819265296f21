"""The noise under which withheld fixes are predicted best: Fisher scoring on the log of settings.

A step is that of Fisher scoring for variances (a setting's square grows by twice the step's share),
which is exact in one for a scale alone, and is halved until the score falls. A weak prior holds
what the drive says nothing of near where it began. Such settings are then put back there and the
others sought again; but where that predicts clearly worse, the drive does say something, if only
from one side: the setting becomes the value nearest to where it began that does not ("bounded").
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.config import SmoothConfig, merge
from fgloc.drive import ImuNoise
from fgloc.errors import SolverError
from fgloc.measurements import Array
from fgloc.tuning.bench import Bench, Predictions
from fgloc.tuning.result import Status, TunedSetting
from fgloc.tuning.rounds import Round
from fgloc.tuning.scoring import Slope, scores, slope, weights

NOISE = (
    "gnss.sigma_scale", "imu.accel_noise_mps2_per_sqrt_hz", "imu.gyro_noise_radps_per_sqrt_hz",
    "imu.accel_bias_walk_mps3_per_sqrt_hz", "imu.gyro_bias_walk_radps2_per_sqrt_hz",
)  # fmt: skip
SLOW_ERRORS = ("gnss.bias_sigma_m", "gnss.bias_tau_s")
"""Sought as well where the configuration has them: a slow error of the fixes and a walk of the
IMU's bias look much alike, so a drive is asked for the one only on request."""
NUDGE = 0.02
"""Slopes are differences over this much of a log: far above the solver's noise."""
DONE, ROUGH = 0.01, 1.0
"""The search ends where a step promises no more than this of the log-likelihood, each block taken
for one fix: a tenth of a sigma. The first, which only looks for outliers, ends sooner."""
COARSE = (0, 1, 2)
"""The settings that the first search changes: a walk moves no fix beyond the gate."""
MOST_STEPS = 15
PRIOR_SIGMA = float(np.log(10.0))
"""What is given is taken to be right to a factor of ten or so."""
UNDETERMINED = float(np.log(2.0))
"""A setting whose log is no surer than this (a factor of two) is not determined by the drive."""
STEPS = 1 / 4, 16.0
"""Least and largest factor on a variance in one step: down, scoring promises too much."""
TOWARDS_FOUND = (0.25, 0.5, 0.75, 1.0)
"""Shares of the way, in logs, at which a bound is looked for."""
CLEARLY = 2.0
"""Sigmas by which one noise must predict worse than another to be worse."""

Tell = Callable[[str], None]


@dataclass(eq=False)
class Point:
    """Where a search stands: log ratios (q,) to where it began, predictions, weighted score."""

    log_ratio: Array
    told: Predictions
    score: float


class Search:
    """The settings of a drive's noise, sought on the rounds that may be seen."""

    def __init__(
        self, bench: Bench, config: SmoothConfig, rounds: tuple[Round, ...], tell: Tell
    ) -> None:
        self.bench, self.config, self.rounds, self.tell = bench, config, rounds, tell
        self.keys = NOISE + SLOW_ERRORS if config.gnss.bias_sigma_m else NOISE
        self.start = np.array([_value(config, bench.noise, key) for key in self.keys])
        self.status: list[Status] = ["found"] * len(self.keys)
        self.sigma = np.full(len(self.keys), np.nan)
        self.evaluations = 0
        self.heavy = False
        self.at = self._settled(np.zeros(len(self.keys)))

    def at_ratio(self, log_ratio: Array) -> SmoothConfig:
        """The configuration with every setting at a ratio to where the search began."""
        return with_settings(self.config, self.keys, self.start * np.exp(log_ratio))

    def given(self) -> SmoothConfig:
        """The configuration with every setting as it was in force when the search began."""
        return self.at_ratio(np.zeros(len(self.keys)))

    def found(self) -> SmoothConfig:
        """The configuration to write: what is kept stays with the rig or where else it was."""
        changed = [j for j, status in enumerate(self.status) if status != "kept"]
        values = self.start[changed] * np.exp(self.at.log_ratio[changed])
        return with_settings(self.config, [self.keys[j] for j in changed], values)

    def settings(self) -> tuple[TunedSetting, ...]:
        """What became of each setting."""
        after = self.start * np.exp(self.at.log_ratio)
        columns = (self.keys, self.start.tolist(), after.tolist(), self.status, self.sigma.tolist())
        return tuple(
            TunedSetting(key, was, now, status, sigma if status == "found" else None)
            for key, was, now, status, sigma in zip(*columns, strict=True)
        )

    def run(self) -> None:
        """Find the outliers, then the noise, and which settings the drive determines."""
        self.heavy = True
        self.at = self._settled(self.at.log_ratio)
        self._descend(list(COARSE), ROUGH)
        self.bench.find_outliers(self.at_ratio(self.at.log_ratio))
        self.heavy = False
        self.at = self._settled(self.at.log_ratio)
        here = self._put_back_silent(self._descend(self._free(), ROUGH))
        while (worst := self._least_determined(here)) is not None:
            here = self._put_back(worst)
        free = self._free()
        back = np.linalg.inv(here.curvature)
        self.sigma[free] = np.sqrt(np.diag(back @ here.scatter @ back))

    def _free(self) -> list[int]:
        return [j for j, status in enumerate(self.status) if status == "found"]

    def _descend(self, free: list[int], done: float) -> Slope:
        """Steps until they promise little or none goes down; the slope near where it ends."""
        for _ in range(MOST_STEPS):
            here = self._slope(free)
            step, promise = self._step(here, free)
            if promise <= done or not self._go(step, free):
                break
        return here

    def _slope(self, free: list[int]) -> Slope:
        nudged = []
        for j in free:
            log_ratio = self.at.log_ratio.copy()
            log_ratio[j] += NUDGE
            self.evaluations += 1
            nudged.append(self.bench.nudge(self.at_ratio(log_ratio), self.rounds))
        return slope(self.at.told, nudged, NUDGE, heavy=self.heavy)

    def _step(self, here: Slope, free: list[int]) -> tuple[Array, float]:
        """The change of the log of the free settings, and what it promises; see `DONE`."""
        blocks = self._blocks()
        hold = 1 / (PRIOR_SIGMA**2 * blocks)
        gradient = here.gradient + hold * self.at.log_ratio[free]
        share = -np.linalg.solve(here.curvature + hold * np.eye(len(free)), gradient)
        step = np.log(np.clip(1 + 2 * share, *STEPS)) / 2
        return step, -float(gradient @ share) * blocks / 2

    def _blocks(self) -> float:
        """How many blocks were withheld."""
        return float((1 / self.at.told.fixes).sum())

    def _go(self, step: Array, free: list[int]) -> bool:
        """Step, or half of it, or a quarter...; whether one went down."""
        for half in (1.0, 0.5, 0.25, 0.125):
            log_ratio = self.at.log_ratio.copy()
            log_ratio[free] += half * step
            try:
                there = self._settled(log_ratio)
            except SolverError:
                continue
            if self._with_prior(there) < self._with_prior(self.at):
                self.at = there
                return True
        return False

    def _with_prior(self, point: Point) -> float:
        return point.score + float(point.log_ratio @ point.log_ratio) / (
            2 * PRIOR_SIGMA**2 * self._blocks()
        )

    def _settled(self, log_ratio: Array) -> Point:
        self.evaluations += 1
        told = self.bench.settle(self.at_ratio(log_ratio), self.rounds)
        score = float(weights(told) @ scores(told, heavy=self.heavy))
        self.tell(f"step {self.evaluations}: log-likelihood of a withheld fix {-score:.4f}")
        return Point(log_ratio, told, score)

    def _put_back_silent(self, here: Slope) -> Slope:
        """Put all settings back of which nothing would be known even if all others were."""
        found = self.at
        alone = 1 / (np.diag(here.informed) + 1 / PRIOR_SIGMA**2)
        silent = np.array(self._free())[alone > UNDETERMINED**2]
        log_ratio = found.log_ratio.copy()
        log_ratio[silent] = 0.0
        self._mark(silent, "kept")
        self.at = self._settled(log_ratio)
        there = self._descend(self._free(), DONE)
        if not clearly_worse(self.at.told, found.told):
            return there
        self._mark(silent, "found")
        self.at = self._settled(found.log_ratio)
        return self._descend(self._free(), DONE)

    def _least_determined(self, here: Slope) -> int | None:
        """The free setting that is least sure, if it is unsure."""
        free = self._free()
        if not free:
            return None
        prior = np.eye(len(free)) / PRIOR_SIGMA**2
        by_blocks = np.diag(np.linalg.inv(here.informed + prior))
        back = np.linalg.inv(here.curvature + prior / self._blocks())
        variance = np.maximum(by_blocks, np.diag(back @ here.scatter @ back))
        worst = int(np.argmax(variance))
        return free[worst] if variance[worst] > UNDETERMINED**2 else None

    def _put_back(self, setting: int) -> Slope:
        """Put a setting back to where it began, or as near to that as predicts no worse."""
        found = self.at
        self._mark([setting], "kept")
        for share in (0.0, *TOWARDS_FOUND):
            log_ratio = found.log_ratio.copy()
            log_ratio[setting] *= share
            self.at = self._settled(log_ratio)
            here = self._descend(self._free(), DONE)
            if not clearly_worse(self.at.told, found.told):
                break
            self._mark([setting], "bounded")
        return here

    def _mark(self, settings: Iterable[int], status: Status) -> None:
        for j in settings:
            self.status[j] = status


def clearly_worse(told: Predictions, other: Predictions) -> bool:
    """Whether predictions score worse than others of the same fixes, by the stretches' scatter."""
    difference = weights(told) * (scores(told) - scores(other))
    parts = np.unique(told.stretch)
    each = np.array([difference[told.stretch == part].sum() for part in parts])
    return bool(each.sum() > CLEARLY * each.std(ddof=1) * len(each) ** 0.5)


def with_settings(config: SmoothConfig, keys: Sequence[str], values: Array) -> SmoothConfig:
    """The configuration with some settings, `section.name`, changed."""
    nested: dict[str, dict[str, float]] = {}
    for key, value in zip(keys, values.tolist(), strict=True):
        section, _, name = key.partition(".")
        nested.setdefault(section, {})[name] = value
    return SmoothConfig.model_validate(merge(config.model_dump(), nested))


def _value(config: SmoothConfig, noise: ImuNoise, key: str) -> float:
    """A setting as it is in force: of the IMU, what the configuration or the rig says."""
    section, _, name = key.partition(".")
    return float(getattr(config.gnss if section == "gnss" else noise, name))
