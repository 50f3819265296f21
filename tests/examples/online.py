# ruff: noqa: T201
"""The library online: once a second, where is the vehicle by what has arrived so far?

    python tests/examples/online.py DRIVE

Every second the graph is solved over the last half minute of what has been received; its newest
state is the answer. Nothing looks ahead. A recorded drive is played here, with fixes that arrive
0.2 s late; on board, `received` would make its tables from what the drivers have handed over.

There is no call that takes one measurement at a time. Of a recording, `mode="fixed-lag"` gives the
same kind of answer for all instants in one run: each state as it was when it was the newest.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace

import fgloc

S = 1_000_000_000
WINDOW_NS, FIRST_NS, DELAY_NS = 30 * S, 10 * S, S // 5


def delayed(drive: fgloc.Drive) -> fgloc.Drive:
    """The drive with its fixes received a little after they were true."""
    return drive.with_tables(gnss=replace(drive.gnss, received_ns=drive.gnss.t_ns + DELAY_NS))


def received(drive: fgloc.Drive, now_ns: int) -> fgloc.Drive:
    """What has arrived by now and is not older than the window."""
    tables = {
        name: table.take((table.received_ns <= now_ns) & (table.t_ns > now_ns - WINDOW_NS))
        for name, table in drive.tables.items()
    }
    return replace(drive, tables=tables, truth=None)


def live(drive: fgloc.Drive) -> Iterator[fgloc.Trajectory]:
    """The newest state, once a second; a drive without enough in its window gives none."""
    for now_ns in range(drive.start_ns + FIRST_NS, drive.end_ns + 1, S):
        try:
            result = fgloc.smooth(received(drive, now_ns))
        except fgloc.DriveError as err:
            print(f"{(now_ns - drive.start_ns) / S:.0f} s: no estimate: {err}")
            continue
        yield result.trajectory.take(slice(-1, None))


def main(name: str) -> None:
    """Print time, place and how sure the estimate is of it."""
    drive = delayed(fgloc.load(name))
    for state in live(drive):
        t_s = (state.t_ns[0] - drive.start_ns) / S
        east, north, _ = state.p_world_m[0]
        along, across = state.sigma_along_across_m()
        print(f"{t_s:7.2f} s  east {east:8.2f} m  north {north:8.2f} m  "
              f"ahead ±{along[0]:.2f} m  left ±{across[0]:.2f} m")  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
