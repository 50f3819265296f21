"""Tracks of other road users held against the truth: which track is whose, and how far off.

A track of a road user that says where it is is that user's. Every other track belongs to the road
user to which it is nearest among the others, by the root mean square over the instants that both
have.
"""

import numpy as np

from fgloc.evaluation.bootstrap import Bootstrap
from fgloc.evaluation.metric import Metric
from fgloc.measurements import Array, ObjectTracks, ObjectTruth
from fgloc.timing import Instants, elapsed_s, seconds_to_ns

Matched = tuple[Instants, Array, Array]
DENSE_NS = 50_000_000
"""Between rows of the truth that are no further apart it is taken along a straight line."""


def errors_by_object(tracks: ObjectTracks, truth: ObjectTruth) -> dict[int, Matched]:
    """For each road user: t_ns (n,), position errors (n, 2) in m, covariances (n, 2, 2).

    Of several tracks of one road user, all rows are taken. One that no track follows has no rows.
    """
    found: dict[int, list[Matched]] = {int(i): [] for i in np.unique(truth.object_id)}
    says = set(np.unique(tracks.user_id).tolist())
    for track in np.unique(tracks.track_id):
        rows = tracks.take(tracks.track_id == track)
        user = int(rows.user_id[0])
        names = [name for name in found if (name == user if user >= 0 else name not in says)]
        pairs = {name: _apart(rows, truth.take(truth.object_id == name)) for name in names}
        known = {name: pair for name, pair in pairs.items() if len(pair[0])}
        if known:
            best = min(known, key=lambda name: float((known[name][1] ** 2).sum(-1).mean()))
            found[best].append(known[best])
    return {name: _together(parts) for name, parts in found.items()}


def _together(parts: list[Matched]) -> Matched:
    if not parts:
        return np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2))
    t_ns, e, cov = zip(*parts, strict=True)
    return np.concatenate(t_ns), np.concatenate(e), np.concatenate(cov)


def score_objects(
    tracks: ObjectTracks, truth: ObjectTruth, start_ns: int, score_from_s: float = 0.0
) -> dict[str, Metric]:
    """Metrics `objects.{id}.*`: RMSE and largest error in m, ANEES by dimension, share followed."""
    b = Bootstrap()
    first_ns = start_ns + seconds_to_ns(score_from_s)
    metrics = {}
    for name, (t_ns, e, cov) in errors_by_object(tracks, truth).items():
        at = f"objects.{name}."
        kept = t_ns >= first_ns
        t_ns, e, cov = t_ns[kept], e[kept], cov[kept]
        wanted = truth.t_ns[(truth.object_id == name) & (truth.t_ns >= first_ns)]
        if len(wanted):
            share = _followed(np.unique(t_ns), wanted)
            metrics[at + "followed_share"] = Metric(share, "1", "higher", len(wanted))
        if not len(e):
            why = "no track follows it"
            metrics |= {at + "horizontal_rmse_m": Metric(None, "m", why=why),
                        at + "horizontal_max_m": Metric(None, "m", why=why),
                        at + "anees": Metric(None, "1", "target", target=1.0, why=why)}  # fmt: skip
            continue
        off = np.linalg.norm(e, axis=-1)
        nees = np.einsum("ni,ni->n", e, np.linalg.solve(cov, e[..., None])[..., 0]) / 2
        low, high = b.rmse(off, t_ns)
        metrics[at + "horizontal_rmse_m"] = Metric(
            float(np.sqrt((off**2).mean())), "m", "lower", len(e), low, high
        )
        metrics[at + "horizontal_max_m"] = Metric(float(off.max()), "m", "lower", len(e))
        low, high = b.mean(nees, t_ns)
        metrics[at + "anees"] = Metric(
            float(nees.mean()), "1", "target", len(e), low, high, 1.0,
            note="East and North, 2 degrees of freedom",
        )  # fmt: skip
    return metrics


def _followed(t_ns: Instants, wanted_ns: Instants) -> float:
    """The share of instants of the truth that have a state within `DENSE_NS`."""
    if not len(t_ns):
        return 0.0
    after = np.searchsorted(t_ns, wanted_ns).clip(1 if len(t_ns) > 1 else 0, len(t_ns) - 1)
    near = np.minimum(abs(t_ns[after] - wanted_ns), abs(t_ns[after - 1] - wanted_ns))
    return float((near <= DENSE_NS).mean())


def _apart(rows: ObjectTracks, truth: ObjectTruth) -> Matched:
    """Errors of a track against one road user where the truth is known."""
    after = np.searchsorted(truth.t_ns, rows.t_ns)
    exact = np.isin(rows.t_ns, truth.t_ns)
    inner = after.clip(1, max(len(truth) - 1, 1))
    gap_ns = np.diff(truth.t_ns, prepend=0)[inner.clip(max=len(truth) - 1)]
    between = (after > 0) & (after < len(truth)) & (gap_ns <= DENSE_NS)
    known = exact | between
    since = elapsed_s(rows.t_ns[known], int(truth.t_ns[0]))
    told_s = elapsed_s(truth.t_ns, int(truth.t_ns[0]))
    place = np.stack([np.interp(since, told_s, axis) for axis in truth.p_world_m.T], -1)
    return rows.t_ns[known], rows.state[known, :2] - place, rows.cov[known][:, :2, :2]
