"""The noise of what aids beside the fixes: wheels, the axis that a car follows, roadside nodes.

Where there is no IMU whose noise would have to be told from theirs, of the fixes as well.

Each of their measurements is left out of the smoothed drive in turn and predicted from all others
(`smoother.left_out`); the sigmas are right where the errors are as large as predicted. A step is
Fisher scoring on the log of the sigmas, by the likelihood of what was left out, over the stretches
that may be seen; the drive is then smoothed again. What lies far beyond the bulk is no matter of
noise and takes no part. The stretches that were not seen show the NIS before and after.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.chi_square import chi2_quantile
from fgloc.config import SmoothConfig
from fgloc.constraints import NON_HOLONOMIC, wheel_of, wheel_source
from fgloc.drive import Drive
from fgloc.evaluation.consistency import anees_band, effective_samples
from fgloc.measurements import Array
from fgloc.positions import DETECTIONS, GNSS
from fgloc.smoother import clocks
from fgloc.smoother.batch import POSITIONS, run_batch
from fgloc.smoother.left_out import LeftOut
from fgloc.smoother.model import Model
from fgloc.sync import plan
from fgloc.tuning.result import AidConsistency, TunedSetting
from fgloc.tuning.rounds import Rounds
from fgloc.tuning.search import PRIOR_SIGMA, STEPS, UNDETERMINED, with_settings

FIXES, WHEEL, LATERAL, VERTICAL, NODES = (
    "gnss.sigma_scale", "vehicle.wheel_sigma_scale", "vehicle.lateral_sigma_mps",
    "vehicle.vertical_sigma_mps", "detections.sigma_scale",
)  # fmt: skip
MOST_ROUNDS = 10
DONE, SMALL = 0.02, 0.2
"""The sigmas are found where no step changes the log of one by more than this, or by more than this
share of its own standard deviation."""
BULK = 0.9999
"""What exceeds this quantile of chi-square, scaled to the median of the NIS, is an outlier."""
FEWEST = 20
"""Of fewer measurements in the stretches that may be seen, nothing is said."""

Tell = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Told:
    """What a drive says of one source under some noise: M measurements left out in turn.

    by_log  (M, q, d, d) change of their own covariance with the log of each of q sigmas
    fine    (M,) bool: not an outlier
    """

    left_out: LeftOut
    by_log: Array
    fine: NDArray[np.bool_]
    t_s: Array


class Aids:
    """The sources of a drive that aid, and their sigmas as they are found."""

    def __init__(self, drive: Drive, config: SmoothConfig, *, fixes: bool = False) -> None:
        """The wheels are tried even where a configuration leaves them out."""
        self._drive = clocks.on_time(drive, config)
        self.keys: dict[str, tuple[str, ...]] = {GNSS: (FIXES,)} if fixes else {}
        if wheel_of(drive) is not None:
            self.keys[wheel_source(drive)] = (WHEEL,)
        if config.vehicle.non_holonomic:
            self.keys[NON_HOLONOMIC] = (LATERAL, VERTICAL)
        if DETECTIONS in drive.tables and config.detections.use:
            self.keys[DETECTIONS] = (NODES,)
        self.start = {key: _value(config, key) for keys in self.keys.values() for key in keys}

    def fix_times_s(self, config: SmoothConfig) -> Array:
        """When the usable fixes are (n,), in s from the first."""
        model = Model(self._drive, plan(self._drive, config), config)
        return np.asarray(model.t_s[model.key_of[model.guides]])

    def tune(
        self, given: SmoothConfig, config: SmoothConfig, rounds: Rounds, tell: Tell
    ) -> tuple[SmoothConfig, tuple[TunedSetting, ...], tuple[AidConsistency, ...]]:
        """The configuration with the sigmas found, what became of them, and whether they hold.

        given   the noise of fixes and IMU as the user has it, under which the NIS is judged before
        config  as it was found
        """
        if not self.keys:
            return config, (), ()
        before, free = self._told(given), dict(self.start)
        sigma: dict[str, float] = {}
        while True:
            now, after, sigma = self._settled(config, free, rounds, tell)
            known = {key: value for key, value in now.items()
                     if sigma[key] <= UNDETERMINED or value < self.start[key]}  # fmt: skip
            if known.keys() == free.keys():
                break
            free = known
        settings = tuple(
            _setting(key, was, now.get(key, was), sigma.get(key, np.inf))
            for key, was in self.start.items()
        )
        held = (_consistency(source, before[source], after[source], rounds)
                for source in self.keys if source in before and source in after)  # fmt: skip
        found = _with(config, now)
        return found, settings, tuple(one for one in held if one is not None)

    def _settled(
        self, config: SmoothConfig, free: dict[str, float], rounds: Rounds, tell: Tell
    ) -> tuple[dict[str, float], dict[str, Told], dict[str, float]]:
        """Some sigmas as they come to rest from where they are, the others as they were given; what
        the drive says under them, and the standard deviation of the log of each."""
        now = dict(free)
        for count in range(MOST_ROUNDS):
            told = self._told(_with(config, now))
            steps, sigma = self._steps(told, now, rounds)
            small = (abs(step) <= max(DONE, SMALL * sigma[key]) for key, step in steps.items())
            if all(small) or count == MOST_ROUNDS - 1:
                break
            now = {key: value * float(np.exp(steps[key])) for key, value in now.items()}
            tell(", ".join(f"{key} = {value:.3g}" for key, value in now.items()))
        return now, told, sigma

    def _told(self, config: SmoothConfig) -> dict[str, Told]:
        """What every source says of itself under a configuration."""
        vehicle = config.vehicle.model_copy(
            update={"wheel_speed": wheel_of(self._drive) is not None}
        )
        config = config.model_copy(update={"vehicle": vehicle})
        model = Model(self._drive, plan(self._drive, config), config)
        left_out = run_batch(model).left_out
        told = {source: _of_source(model, left_out, source) for source in self.keys}
        return {source: one for source, one in told.items() if one is not None}

    def _steps(
        self, told: dict[str, Told], now: dict[str, float], rounds: Rounds
    ) -> tuple[dict[str, float], dict[str, float]]:
        """The change of the log of every sigma that is free, and that log's standard deviation. One
        that has come down to where the drive no longer tells it goes no further."""
        steps, sigmas = dict.fromkeys(now, 0.0), dict.fromkeys(now, np.inf)
        for source, one in told.items():
            keys = self.keys[source]
            gone = np.array([np.log(now.get(key, 1.0) / self.start[key]) for key in keys])
            for key, step, sigma in zip(keys, *_scored(one, gone, rounds), strict=True):
                if key in now:
                    steps[key] = step if step > 0 or sigma <= UNDETERMINED else 0.0
                    sigmas[key] = sigma
        return steps, sigmas


def _setting(key: str, before: float, after: float, sigma: float) -> TunedSetting:
    """What became of a setting whose log has this standard deviation."""
    if sigma <= UNDETERMINED:
        return TunedSetting(key, before, after, "found", sigma)
    return TunedSetting(key, before, after, "bounded" if after < before else "kept", None)


def _with(config: SmoothConfig, values: dict[str, float]) -> SmoothConfig:
    return with_settings(config, list(values), np.array(list(values.values())))


def _of_source(model: Model, left_out: Mapping[str, LeftOut], source: str) -> Told | None:
    """What one source says of itself, or None where nothing of it was taken."""
    if source in (GNSS, DETECTIONS):
        told, seen = left_out[POSITIONS], model.positions.candidates
        rows = (seen & told.kept if source == DETECTIONS else ~seen) & told.informed
        told = told.take(rows, dof=2 if source == DETECTIONS else 3)
        by_log = 2 * told.own[:, None]
    elif source in left_out:
        told = left_out[source]
        told = told.take(told.informed, told.error.shape[1])
        by_log = 2 * told.own[:, None]
        if source == NON_HOLONOMIC:
            lateral = model.car.config.lateral_sigma_mps / model.car.slip_sigmas_mps[told.keys, 0]
            by_log = np.zeros((len(told.keys), 2, 2, 2))
            by_log[:, 0, 0, 0], by_log[:, 1, 1, 1] = 2 * lateral**2, 2.0
    else:
        return None
    if not len(told.keys):
        return None
    dof = told.error.shape[1]
    bulk = float(np.median(told.nis)) / chi2_quantile(0.5, dof)
    return Told(told, by_log, told.nis <= bulk * chi2_quantile(BULK, dof), model.t_s[told.keys])


def _sides(told: Told, rounds: Rounds) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of each measurement the stretch, and whether that is seen; see `Rounds`."""
    at = np.searchsorted(rounds.t_s, told.t_s, side="right") - 1
    return rounds.stretch[at], rounds.side[at]


def _scored(told: Told, gone: Array, rounds: Rounds) -> tuple[list[float], list[float]]:
    """One step of Fisher scoring for the log of each sigma (q,), which has gone so far from where
    it began, and its standard deviation: by what each measurement tells, or by the scatter between
    stretches where that is more."""
    stretch, side = _sides(told, rounds)
    rows = (side == 1) & told.fine
    q = told.by_log.shape[1]
    if rows.sum() < FEWEST:
        return [0.0] * q, [np.inf] * q
    one, stretch = told.left_out, stretch[rows]
    inverse = np.linalg.inv(one.cov + one.own)[rows]
    weighed = inverse[:, None] @ told.by_log[rows]
    seen = np.einsum("nij,nj->ni", inverse, one.error[rows])
    gradient = np.trace(weighed, axis1=-2, axis2=-1) / 2
    gradient -= np.einsum("ni,nqij,nj->nq", seen, told.by_log[rows], seen) / 2
    fisher = np.einsum("nqij,nrji->qr", weighed, weighed) / 2
    back = np.linalg.inv(fisher + np.eye(q) / PRIOR_SIGMA**2)
    share = -back @ (gradient.sum(0) + gone / PRIOR_SIGMA**2)
    each = np.stack([gradient[stretch == part].sum(0) for part in np.unique(stretch)])
    each -= each.mean(0)
    scatter = each.T @ each * len(each) / max(len(each) - 1, 1)
    variance = np.maximum(np.diag(back), np.diag(back @ scatter @ back))
    return (np.log(np.clip(1 + 2 * share, *STEPS)) / 2).tolist(), np.sqrt(variance).tolist()


def _consistency(source: str, before: Told, after: Told, rounds: Rounds) -> AidConsistency | None:
    """The NIS of what the search has not seen; None where there is nothing."""
    dof, nis = after.left_out.error.shape[1], []
    for told in (before, after):
        rows = (_sides(told, rounds)[1] == -1) & told.fine
        nis.append(told.left_out.nis[rows] / dof)
    if not len(nis[0]) or not len(nis[1]):
        return None
    worth = effective_samples(nis[1])
    low, high = anees_band(worth, dof)
    return AidConsistency(
        source=source, n=len(nis[1]), worth=worth, low=low, high=high,
        nis_before=float(nis[0].mean()), nis_after=float(nis[1].mean()),
        outliers=int((~after.fine).sum()),
    )  # fmt: skip


def _value(config: SmoothConfig, key: str) -> float:
    section, _, name = key.partition(".")
    return float(getattr(getattr(config, section), name))
