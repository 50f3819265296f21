"""A first solution of a long chain from a few of its keyframes, about one a second.

From a guess, the attitudes need some Newton steps to come near. They need no more than a fix a
second for it, so a drive with ten pays a tenth. The IMU between the few keyframes is what was
preintegrated between all of them, put together; afterwards it carries the states to the others.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import imu
from fgloc.factors.preintegration import joined
from fgloc.parallel import each
from fgloc.references import References
from fgloc.smoother.model import Model
from fgloc.smoother.states import States

APART_S = 1.0
WORTH = 3
"""A sketch is worth its trouble where it has this many times fewer keyframes than the drive."""
AT_ONCE = 1800
"""So many intervals are put together at a time, which fit the processor's cache."""

Keys = NDArray[np.int64]


def few_keyframes(model: Model, n: int) -> Keys | None:
    """The first of each second among the first n keyframes, rather one with a fix, and the last.

    None where that would not be few, or where constraints of the vehicle act between them.
    """
    if model.car.acts or model.car.stands.any() or len(model.car.velocities.keys):
        return None
    second, no_fix = (model.t_s[:n] / APART_S).astype(int), np.ones(n, bool)
    no_fix[model.key_of[model.fixed(0, n)]] = False
    order = np.lexsort((no_fix, second))
    _, first = np.unique(second[order], return_index=True)
    keys = np.union1d(order[first], [0, n - 1])
    return keys if WORTH * len(keys) <= n else None


def few_model(model: Model, keys: Keys, gated: NDArray[np.bool_]) -> Model:
    """The model of a drive with some of its keyframes, and the positions at these that are not
    gated (of the first so many); the others become epochs between."""
    epochs = model.epochs
    is_keyframe = np.zeros(len(epochs), bool)
    is_keyframe[model.epoch_of[keys]] = True
    there = np.zeros(len(model.key_of), bool)
    there[: len(gated)] = ~gated & np.isin(model.key_of[: len(gated)], keys)
    plan = replace(
        model.plan,
        epochs=replace(epochs, is_keyframe=is_keyframe),
        positions=model.positions.take(there),
        references=References.none(),
        posts=(),
    )
    few = Model(model.drive, plan, model.config)
    few.shifted_s = model.shifted_s
    return few


def few_deltas(deltas: imu.ImuDeltas, keys: Keys) -> imu.ImuDeltas:
    """The IMU from each of some keyframes to the next, from that between all keyframes."""
    parts = each(lambda own: joined(deltas, own), _portions(keys))
    return imu.ImuDeltas(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _portions(keys: Keys) -> list[Keys]:
    """Keyframes in portions, each with the first of the next one."""
    return [keys[k : k + AT_ONCE + 1] for k in range(0, len(keys) - 1, AT_ONCE)]


def all_states(
    few: States, keys: Keys, deltas: imu.ImuDeltas, bias_of: Keys, gravity_mps2: float
) -> States:
    """States of all keyframes up to the last of `keys`, which the IMU carries on from these."""
    n = keys[-1] + 1
    of = np.searchsorted(keys, np.arange(n), side="right") - 1
    R, p, v, bias = few.R[of], few.p[of], few.v[of], few.bias[of]
    d, dt_s = imu.corrected(deltas.take(slice(n - 1)), bias[:-1]), deltas.dt_s

    def carry(keys: Keys) -> None:
        for some, rows in _steps(keys):
            i = rows[rows + 1 < keys[some + 1]]
            told = imu.carried(d[i], dt_s[i], R[i], p[i], v[i], gravity_mps2)
            R[i + 1], p[i + 1], v[i + 1] = told

    each(carry, _portions(keys))
    first = np.searchsorted(bias_of[:n], bias_of[:n])
    return replace(few, R=R, p=p, v=v, bias=bias[first], slow=few.slow[of], posts=few.posts[of])


def _steps(keys: Keys) -> Iterator[tuple[Keys, Keys]]:
    """Step by step from keyframe to keyframe, the intervals between keys that are not at their end
    yet, and the keyframes where they are."""
    for s in range(int(np.diff(keys).max(initial=0))):
        some = np.flatnonzero(keys[:-1] + s < keys[1:])
        yield some, keys[some] + s
