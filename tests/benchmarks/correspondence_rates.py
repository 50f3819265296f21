# ruff: noqa: T201
"""How often each matching fails, per number of objects, with 95 % intervals.

    python tests/benchmarks/correspondence_rates.py [--layouts 1000] [--sizes 3,5,10] [--one-sided]

Layouts in 80 x 80 m with any heading, noise of 0.3 m, 20 % missing and 20 % ghosts in the node's
set and in the car's. Ambiguous layouts are found by an exhaustive search and left out of the rates.
"""

import argparse

from fgloc.evaluation.correspondence import METHODS, study


def main() -> None:
    """Print a line for each size and method."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layouts", type=int, default=1000)
    parser.add_argument("--sizes", default="3,5,10,20,30")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--one-sided", action="store_true", help="missed by the car, ghosts of the node"
    )
    args = parser.parse_args()
    methods = {name: METHODS[name] for name in args.methods.split(",")}
    print(
        "objects clear method        failed %  (95 %)        heading wrong none  found likely  ms"
    )
    for size in map(int, args.sizes.split(",")):
        options = {"one_sided": args.one_sided}
        for row in study(args.layouts, [size], args.seed, methods=methods, options=options):
            rates = (row.heading, row.wrong_pair, row.no_answer, row.found, row.found_likely)
            print(
                f"{size:7d} {row.layouts - row.ambiguous:5d} {row.method:12s} "
                f"{100 * row.failed.value:8.2f} ({100 * row.failed.low:5.2f} to "
                f"{100 * row.failed.high:6.2f}) "
                + " ".join(f"{100 * rate.value:6.1f}" for rate in rates)
                + f" {1e3 * row.median_s:5.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
