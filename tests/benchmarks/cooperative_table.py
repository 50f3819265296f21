# ruff: noqa: T201
"""All methods on the cooperative scenarios: RMSE and ANEES per road user, the occlusion apart.

    python tests/benchmarks/cooperative_table.py [--seeds 50] [--scenarios one-node,two-nodes,..]

Ratios are of RMSEs paired by seed against the consensus filter, with the upper 95 % limit of a
bootstrap over seeds. `drive from nodes` is the graph on a drive in which the car has no sensors.
`even` is the largest over the least RMSE of the car in four bins
along the road, once half a second has passed.
"""

import argparse
from collections.abc import Callable

import numpy as np

import fgloc
from fgloc import baselines
from fgloc.baselines.khamooshi2023_kcf import Sources, run_sources
from fgloc.datasets import make
from fgloc.errors import FglocError
from fgloc.evaluation.objects import errors_by_object

SCENARIOS = ("one-node", "two-nodes", "acceleration", "correspondence", "intersection")
AGAINST = "khamooshi2023-kcf"
BINS, FROM = 4, 5
BOOTSTRAPS = 2000


def methods(nodes: int) -> dict[str, Callable]:
    """Each method's name and what it makes of a drive."""
    alone = {
        f"node {i + 1} alone": lambda d, i=i: run_sources(d, Sources(car=False, nodes=(i,)))
        for i in range(nodes)
    }
    return {
        AGAINST: lambda d: baselines.run(d, AGAINST),
        "onboard alone": lambda d: baselines.run(d, "khamooshi2023-kcf:onboard"),
        **alone,
        "covariance-intersection": lambda d: baselines.run(d, "covariance-intersection"),
        "graph-lag": lambda d: fgloc.smooth(d, mode="fixed-lag"),
        "graph-batch": lambda d: fgloc.smooth(d, mode="batch"),
    }


def main() -> None:
    """Print a table for each scenario."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--scenarios", default=",".join(SCENARIOS))
    args = parser.parse_args()
    all_ratios = {"graph-lag": [], "graph-batch": []}
    for name in args.scenarios.split(","):
        drives = [make(f"khamooshi2023/{name}", seed) for seed in range(args.seeds)]
        print(f"\n{name}, {args.seeds} seeds: RMSE in m of car (0) and others, ANEES, ratio to KCF")
        rows = {}
        for method, run in methods(len(drives[0].infrastructure.nodes)).items():
            try:
                rows[method] = [errors(run(drive), drive) for drive in drives]
            except FglocError as err:
                print(f"{method:24s} {err}")
                continue
            show(method, rows, all_ratios)
        unseen = [make(f"khamooshi2023/{name}", s, onboard=False) for s in range(args.seeds)]
        rows["drive from nodes"] = [errors(fgloc.smooth(d, mode="batch"), d) for d in unseen]
        show("drive from nodes", rows, all_ratios)
    for method, ratios in all_ratios.items():
        print(f"{method}: geometric mean of all ratios {np.exp(np.mean(np.log(ratios))):.3f}")


def errors(result: object, drive: object) -> dict:
    """By road user: squared errors (n,), NEES by dimension (n,), which rows are hidden (n,)."""
    t_ns = result.trajectory.t_ns
    e = (result.trajectory.p_world_m - drive.truth.at(t_ns).p_world_m)[:, :2]
    found = {0: (t_ns, e, result.trajectory.cov[:, :2, :2])}
    found |= errors_by_object(result.objects, drive.objects)
    hidden = hidden_ns(drive)
    return {
        name: (
            (e**2).sum(-1),
            np.einsum("ni,ni->n", e, np.linalg.solve(cov, e[..., None])[..., 0]) / 2,
            np.isin(t, hidden) & (name == 1), t,
        )
        for name, (t, e, cov) in found.items() if len(e)
    }  # fmt: skip


def hidden_ns(drive: object) -> np.ndarray:
    """Instants at which the car cannot see road user 1, of the intersection."""
    own = drive.tables.get("relative")
    if own is None or "intersection" not in drive.name:
        return np.empty(0, np.int64)
    return np.setdiff1d(drive.truth.t_ns, own.t_ns[own.kind == 1])


def show(method: str, rows: dict, all_ratios: dict) -> None:
    """A line: each road user's RMSE, ANEES, ratio and its upper limit; then what is special."""
    cells, extra = [], ""
    for name in rows[method][0]:
        squares = [seed[name][0] for seed in rows[method]]
        nees = np.mean([seed[name][1].mean() for seed in rows[method]])
        text = f"{name}: {np.sqrt(np.mean([s.mean() for s in squares])):.3f} ({nees:.2f})"
        if method != AGAINST and AGAINST in rows:
            ratio, upper = paired(rows[method], rows[AGAINST], name)
            text += f" x{ratio:.3f} <{upper:.3f}"
            if method in all_ratios:
                all_ratios[method].append(ratio)
        cells.append(text)
        hidden = [seed[name][0][seed[name][2]] for seed in rows[method]]
        if sum(map(len, hidden)):
            extra = f"  hidden 1: {np.sqrt(np.concatenate(hidden).mean()):.3f}"
    bins = np.array([
        [b.mean() for b in np.array_split(seed[0][0][FROM:], BINS)] for seed in rows[method]
    ])  # fmt: skip
    even = np.sqrt(bins.mean(0))
    print(f"{method:24s} " + "; ".join(cells) + extra + f"  even {even.max() / even.min():.2f}",
          flush=True)  # fmt: skip


def paired(ours: list, theirs: list, name: int) -> tuple[float, float]:
    """Ratio of the RMSEs over the instants that both have, and its upper 95 % limit."""
    pairs = []
    for a, b in zip(ours, theirs, strict=True):
        _, i, j = np.intersect1d(a[name][3], b[name][3], return_indices=True)
        pairs.append((a[name][0][i].mean(), b[name][0][j].mean()))
    squares = np.array(pairs)
    draw = np.random.default_rng(0).integers(0, len(squares), (BOOTSTRAPS, len(squares)))
    means = squares[draw].mean(1)
    ratio = np.sqrt(squares[:, 0].mean() / squares[:, 1].mean())
    return float(ratio), float(np.quantile(np.sqrt(means[:, 0] / means[:, 1]), 0.95))


if __name__ == "__main__":
    main()
