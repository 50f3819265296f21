# ruff: noqa: T201
"""A simulated recording of a roadside node's cameras and LiDARs, to try `fgloc perceive` on.

    python tests/examples/simulated_street.py street --seconds 5 [--seed 3] [--sway 0.05] [--mcity]

Writes images of 1920 x 1200 px and clouds at 10 Hz, 2 cameras and 2 LiDARs, with the truth of all
road users; `--mcity` is the second pass of `lee2021/mcity`, 23 s.
"""

import argparse

from fgloc.datasets.perception_recording import write_recording
from fgloc.datasets.streets import make_mcity_street, make_street


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sway", type=float, default=0.0, help="amplitude of the node's tip in m")
    parser.add_argument("--mcity", action="store_true")
    given = parser.parse_args(arguments)
    if given.mcity:
        recording = make_mcity_street(given.seed)
    else:
        recording = make_street(given.seed, given.seconds, given.sway)
    write_recording(recording, given.out)
    print(f"{len(recording.images[0])} frames of each sensor in {given.out}")


if __name__ == "__main__":
    main()
