"""Withheld fixes as predicted from all others, under one noise or another."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.config import SmoothConfig
from fgloc.drive import Drive, ImuNoise, Noise
from fgloc.factors.imu import ImuDeltas
from fgloc.measurements import Array
from fgloc.smoother import clocks
from fgloc.smoother.band import BorderedFactor
from fgloc.smoother.batch import run_batch
from fgloc.smoother.chain import Chain, position_errors
from fgloc.smoother.guess import guess, yaw_by_turns
from fgloc.smoother.half import NotPositiveError
from fgloc.smoother.model import Model
from fgloc.smoother.states import Robustness, States
from fgloc.smoother.terms import POSE
from fgloc.sync import plan
from fgloc.tuning.rounds import Round
from fgloc.verdicts import Verdict

ENOUGH = 0.01
"""A prediction is good where a Newton step promises less than this of the cost, half a chi-square:
the graph is so nearly linear around the states of another noise that one or two steps do."""
MOST_STEPS = 10
ACCEL, GYRO = "accel_noise_mps2_per_sqrt_hz", "gyro_noise_radps_per_sqrt_hz"
NOTHING = 1e-30
"""A density that adds nothing to any covariance."""
PLAIN = {"loss": "none", "gate_probability": 1.0}
"""No loss and no gate: with noise far too small they would throw out good fixes, and what is left
would look consistent."""


@dataclass(frozen=True, eq=False)
class Predictions:
    """M withheld fixes: predicted minus measured (M, 3) in m ENU, with its covariance (M, 3, 3).

    common   (M,) share of the covariance that is not the fix's own, 0 to 1
    fixes    (M,) how many were withheld in a row
    stretch  (M,) the stretch of the drive
    t_s      (M,) when, from the first fix on
    """

    error: Array
    cov: Array
    common: Array
    fixes: NDArray[np.int64]
    stretch: NDArray[np.int64]
    t_s: Array


class Motion:
    """The IMU between keyframes, preintegrated once for all noise.

    Its covariance grows with the square of the accelerometer's density, with that of the gyro's,
    and has a rest: the integration's own noise, and all of it in a gap.
    """

    def __init__(self, model: Model) -> None:
        self._noise = model.noise
        self._deltas = _preintegrated(model, {ACCEL: NOTHING, GYRO: NOTHING})
        self._by_accel = _preintegrated(model, {GYRO: NOTHING}).cov - self._deltas.cov
        self._by_gyro = _preintegrated(model, {ACCEL: NOTHING}).cov - self._deltas.cov

    def under(self, noise: Noise) -> ImuDeltas:
        """What the IMU tells with some noise."""
        accel, gyro = (
            (getattr(noise, key) / getattr(self._noise, key)) ** 2 for key in (ACCEL, GYRO)
        )
        cov = self._deltas.cov + accel * self._by_accel + gyro * self._by_gyro
        return self._deltas._replace(cov=cov)


def _preintegrated(model: Model, noise: dict[str, float]) -> ImuDeltas:
    """The model's deltas between keyframes, with some of the IMU's noise changed."""
    config = model.config.model_copy(update={"imu": model.config.imu.model_copy(update=noise)})
    return Model(model.drive, model.plan, config).deltas()[0]


class Bench:
    """A drive whose fixes are withheld in rounds.

    It keeps the states of the last `settle` for each round, to start from. `outliers` (fixes,) are
    withheld in every round, and never scored.
    """

    def __init__(self, drive: Drive, config: SmoothConfig) -> None:
        """Raises DriveError where the drive lacks fixes, or the noise of its IMU."""
        self.drive = clocks.on_time(drive, config)
        self.plan = plan(self.drive, config)
        model = Model(self.drive, self.plan, plain(config))
        assert isinstance(model.noise, ImuNoise)
        self.noise = model.noise
        self.fix_t_s = model.t_s[model.key_of]
        self.outliers = np.zeros(len(self.fix_t_s), bool)
        self._guess = guess(model, 0, len(model) - 1, yaw_by_turns(model))
        self._motion = Motion(model)
        self._start: States | None = None
        self._states: dict[int, States] = {}

    def find_outliers(self, config: SmoothConfig) -> None:
        """Those that smoothing with a configuration gates: far beyond what its noise explains."""
        planned = plan(self.drive, config)
        model = Model(self.drive, planned, config)
        run_batch(model)
        rows = model.positions.row
        self.outliers = planned.verdicts["gnss"].is_(Verdict.GATED)[rows]

    def settle(self, config: SmoothConfig, rounds: Sequence[Round]) -> Predictions:
        """Solve all rounds, each from where it was settled last. Raises SolverError."""
        chain = self._chain(config)
        solved = [self._solve(chain, one, MOST_STEPS) for one in rounds]
        for one, (states, _) in zip(rounds, solved, strict=True):
            self._states[id(one)] = states
        return self._gathered(chain, rounds, solved)

    def nudge(self, config: SmoothConfig, rounds: Sequence[Round]) -> Predictions:
        """The same for noise next to that of the settled rounds, by one Newton step."""
        chain = self._chain(config)
        return self._gathered(chain, rounds, [self._solve(chain, one, 1) for one in rounds])

    def _chain(self, config: SmoothConfig) -> Chain:
        """The graph under a configuration."""
        model = Model(self.drive, self.plan, plain(config))
        return Chain(model, self._guess, self._motion.under(model.noise))

    def _solve(self, chain: Chain, one: Round, most: int) -> tuple[States, Array]:
        """States of a round, and the poses' covariances, with those of the GNSS bias (n, q, q)."""
        robust = Robustness(one.withheld | self.outliers, np.inf)
        states = self._states.get(id(one)) or self._first(chain)
        keep = np.concatenate([POSE, *chain.slow_at.values()])
        try:
            states, factor = _newton(chain, states, robust, most)
        except NotPositiveError:
            states, _, _ = chain.optimum(states, robust)
            states, factor = _newton(chain, states, robust, 1)
        return states, factor.inverse_blocks(keep)

    def _first(self, chain: Chain) -> States:
        """The drive smoothed as a whole, heading and all; every round begins there."""
        if self._start is None:
            run, at = run_batch(chain.model), chain.model.epoch_of
            log, zero = run.log, np.zeros((len(at), 3))
            bias = np.hstack([zero, log.gyro_bias[at]])
            slow = np.zeros((len(at), chain.post_first - 15))
            pose = log.R[at], log.p[at], log.v[at]
            posts = run.states.posts
            self._start = States(*pose, bias, slow, run.states.late_s, posts=posts)
        return self._start

    def _gathered(
        self, chain: Chain, rounds: Sequence[Round], solved: Sequence[tuple[States, Array]]
    ) -> Predictions:
        """The scored fixes of all rounds, one round after the other, without the outliers."""
        parts = []
        for one, (states, cov) in zip(rounds, solved, strict=True):
            kept = ~self.outliers[one.scored]
            scored, length = one.scored[kept], np.full(int(kept.sum()), one.fixes)
            parts.append((*_compared(chain, states, cov, scored), length, one.stretch[kept],
                          self.fix_t_s[scored]))  # fmt: skip
        return Predictions(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def plain(config: SmoothConfig) -> SmoothConfig:
    """The configuration without loss and gate; see `PLAIN`."""
    return config.model_copy(update={"gnss": config.gnss.model_copy(update=PLAIN)})


def _newton(
    chain: Chain, states: States, robust: Robustness, most: int
) -> tuple[States, BorderedFactor]:
    """States after some steps, and the factor of the last one; NotPositiveError as it comes."""
    while True:
        _, band = chain.linearize(states, robust, "weights")
        factor, most = band.factor(), most - 1
        step = factor.solve(band.gradient)
        states = chain.moved(states, step)
        if most == 0 or step.dot(band.gradient) / 2 <= ENOUGH:
            return states, factor


def _compared(
    chain: Chain, states: States, cov: Array, fixes: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """Errors (k, 3), covariances (k, 3, 3) and the state's share in them (k,) of some fixes as
    predicted."""
    model, at = chain.model, chain.key_of[fixes]
    by_pose = states.R[at] @ model.point_by_pose[0]
    by_bias = np.broadcast_to(np.eye(3), (len(at), 3, 3))
    H = np.concatenate([by_pose, by_bias], -1)[..., : cov.shape[-1]]
    P = H @ cov[at] @ H.swapaxes(-1, -2)
    S = P + model.cov_m2[fixes]
    return (
        position_errors(model, states, np.arange(chain.rows))[fixes],
        S,
        np.trace(np.linalg.solve(S, P), axis1=1, axis2=2) / 3,
    )
