"""Tracks of other road users held against the truth: which track is whose, and how far off.

Every track belongs to the road user to which it is nearest, by the root mean square over the
instants that both have.
"""

import numpy as np

from fgloc.evaluation.bootstrap import Bootstrap
from fgloc.evaluation.metric import Metric
from fgloc.measurements import Array, ObjectTracks, ObjectTruth
from fgloc.timing import Instants, seconds_to_ns

Matched = tuple[Instants, Array, Array]


def errors_by_object(tracks: ObjectTracks, truth: ObjectTruth) -> dict[int, Matched]:
    """For each road user: t_ns (n,), position errors (n, 2) in m, covariances (n, 2, 2).

    Of several tracks of one road user, all rows are taken. One that no track follows has no rows.
    """
    found: dict[int, list[Matched]] = {int(i): [] for i in np.unique(truth.object_id)}
    for track in np.unique(tracks.track_id):
        rows = tracks.take(tracks.track_id == track)
        pairs = {name: _apart(rows, truth.take(truth.object_id == name)) for name in found}
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
        wanted = int((truth.t_ns[truth.object_id == name] >= first_ns).sum())
        if wanted:
            share = min(len(np.unique(t_ns)) / wanted, 1.0)
            metrics[at + "followed_share"] = Metric(share, "1", "higher", wanted)
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


def _apart(rows: ObjectTracks, truth: ObjectTruth) -> Matched:
    """Errors of a track against one road user at the instants that both have."""
    _, mine, theirs = np.intersect1d(rows.t_ns, truth.t_ns, return_indices=True)
    return (
        rows.t_ns[mine], rows.state[mine, :2] - truth.p_world_m[theirs], rows.cov[mine][:, :2, :2],
    )  # fmt: skip
