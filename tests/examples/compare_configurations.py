# ruff: noqa: T201
"""Two configurations of the graph on the same drive: which is better, and is that more than luck?

    python tests/examples/compare_configurations.py DRIVE OUT

The command line does the same: fgloc compare DRIVE --config plain=plain.toml --config ...
"""

import sys
from pathlib import Path

import fgloc
from fgloc.outputs import write_comparison

CONFIGS = {
    "as it is": fgloc.SmoothConfig(),
    "no robust loss": fgloc.SmoothConfig.model_validate({"gnss": {"loss": "none"}}),
}


def main(drive: str, out: str) -> None:
    """Print both and their difference, paired in time; OUT gets the table and a page."""
    table = fgloc.compare(drive, configs=CONFIGS)
    for row in table.rows:
        if row.failed:
            print(f"{row.method}: {row.failed}")
            continue
        rmse = row.metrics["horizontal_rmse_m"]
        print(f"{row.method}: {rmse.value:.3f} m ({rmse.low:.3f} to {rmse.high:.3f})")
        if row.difference is not None:
            low, high = row.difference.low, row.difference.high
            word = "more than luck" if low > 0 or high < 0 else "no difference to be seen"
            print(f"  minus {table.against}: {low:+.4f} to {high:+.4f} m: {word}")
    write_comparison(Path(out), table)


if __name__ == "__main__":
    main(*sys.argv[1:])
