# ruff: noqa: T201
"""Time of one fixed-lag update by the number of road users: nodes at 10 Hz, every user seen by two.

    python tests/benchmarks/cooperative_users.py [--users 25,50,100,200,400] [--nodes 10] [--slow]

The first is the car, which sees the 20 nearest. The states and covariances of all are read at every
update. All sightings come at once, or all of them 0.3 s late. With `--slow` the nodes
have slow errors, and then all road users depend on each other.
"""

import argparse
import time

import numpy as np

from fgloc.correspondence.epochs import Epoch
from fgloc.infrastructure import Node
from fgloc.smoother.cooperative_lag import Window
from fgloc.smoother.cooperative_model import Roster

LAG_S, STEPS, SIGMA_M = 5.0, 80, 0.3
SEEN_BY_CAR = 20
LATE_STEPS = 3


def main() -> None:
    """Print a line for each number of users."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--users", default="25,50,100,200,400")
    parser.add_argument("--nodes", type=int, default=10)
    parser.add_argument("--slow", action="store_true")
    args = parser.parse_args()
    print("users  late  ms per update: update  estimates  all (median)  all (95 %)  factors")
    for users in map(int, args.users.split(",")):
        for late in (0, LATE_STEPS):
            print(line(users, args.nodes, late, 0.5 if args.slow else 0.0), flush=True)


def line(users: int, nodes: int, late: int, slow_m: float) -> str:
    """Times of the updates once the lag is full."""
    rng = np.random.default_rng(0)
    place, speed = rng.uniform(-200, 200, (users, 2)), rng.uniform(-10, 10, (users, 2))
    posts = tuple(Node(f"n{i}", np.array([*rng.uniform(-200, 200, 2), 10.0]), sigma_position_m=0.1,
                       bias_sigma_m=slow_m) for i in range(nodes))  # fmt: skip
    near = np.argsort([[np.hypot(*(p - n.p_world_m[:2])) for n in posts] for p in place])[:, :2]
    graph, times = Window(Roster(0, posts), LAG_S), []
    for k in range(STEPS):
        one = epoch(k, place + 0.1 * k * speed, near, rng)
        arrived = {k - late: np.arange(2 * users)} if k >= late else {}
        marks = [time.perf_counter()]
        graph.update(one, 0.0, arrived)
        marks.append(time.perf_counter())
        graph.states(list(range(users)))
        marks.append(time.perf_counter())
        times.append(np.diff(marks))
    full = 1e3 * np.array(times)[int(LAG_S * 10) + 5 :]
    total = full.sum(1)
    parts = "  ".join(f"{x:6.1f}" for x in np.median(full, 0))
    ends = f"{np.median(total):9.1f}  {np.quantile(total, 0.95):10.1f}  {graph.factors}"
    return f"{users:5d}  {late / 10:3.1f}s  {'':15s}{parts}  {ends}"


def epoch(k: int, place: np.ndarray, near: np.ndarray, rng: np.random.Generator) -> Epoch:
    """What two nodes see of each user, and the car of the nearest."""
    users, t_ns = len(place), k * 100_000_000
    track = np.repeat(np.arange(users), 2)
    z = place[track] + SIGMA_M * rng.standard_normal((2 * users, 2))
    order = np.argsort(np.linalg.norm(place - place[0], axis=1))[1 : SEEN_BY_CAR + 1]
    noise = SIGMA_M**2 * np.eye(2)
    return Epoch(
        t_ns, near.ravel(), track, z, np.tile(noise, (2 * users, 1, 1)), np.arange(2 * users),
        np.full(2 * users, t_ns), place[0] + rng.standard_normal(2), np.eye(2), order,
        place[order] - place[0] + SIGMA_M * rng.standard_normal((len(order), 2)),
        np.tile(noise, (len(order), 1, 1)), 0.0, 0.01,
    )  # fmt: skip


if __name__ == "__main__":
    main()
