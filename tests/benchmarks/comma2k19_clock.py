# ruff: noqa: T201
"""How late the fixes of `comma2k19` are: what the graph can know of it, and what the signals say.

    python tests/benchmarks/comma2k19_clock.py [SEGMENT]

First the graph's estimates, with their sigmas, by what carries the states. Then lags between
speeds, each the shift under which one signal is best told by another: of the positions (slopes over
0.6 s), the wheels, the pose, and with the SEGMENT as published of the receiver's own speed as well.
Last the fixes against the pose along the road: a lateness and a constant offset look alike where
the speed hardly changes; a line through their errors over speed tells how much of each there is.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import fgloc
from fgloc.measurements import Array
from fgloc.smoother.lines import Lines
from fgloc.timing import elapsed_s

WHEELS = ("vehicle.wheel_speed=true", "vehicle.non_holonomic=true")
HALF_S = 0.3
Signal = tuple[Array, Array]


def estimates(drive: fgloc.Drive) -> None:
    """Print what the graph estimates under four ways of carrying the states."""
    no_imu = {name: table for name, table in drive.tables.items() if name != "imu"}
    wheels_alone = replace(drive, tables=no_imu)
    for name, one, asked, settings in (
        ("IMU", drive, "gnss", ()),
        ("IMU, wheels, no slip", drive, "gnss", WHEELS),
        ("the same, wheels' clock as well", drive, "gnss,wheel", WHEELS),
        ("wheels without the IMU", wheels_alone, "gnss", ()),
    ):
        result = fgloc.smooth(one, settings=[f"clock.estimate={asked}", *settings])
        found = [f"{source} {told['late_s']:+.3f} +- {told['sigma_s']:.3f} s"
                 for source, told in result.summary["clock"].items()]  # fmt: skip
        rmse_m = fgloc.score(result.trajectory, one.truth)["horizontal_rmse_m"].value
        print(f"{name}: {', '.join(found)}; horizontal RMSE {rmse_m:.2f} m", flush=True)


def lag_s(one: Signal, other: Signal) -> tuple[float, float]:
    """By how much the first is later, and the rms of what a scale and an offset leave."""
    t, x = (column[(one[0] > other[0][0] + 2) & (one[0] < other[0][-1] - 2)] for column in one)
    shifts, left = np.arange(-0.5, 0.5, 0.005), []
    for shift in shifts:
        A = np.stack([np.interp(t - shift, *other), np.ones_like(t)], -1)
        left.append(float(((x - A @ np.linalg.lstsq(A, x, rcond=None)[0]) ** 2).mean()))
    return float(shifts[np.argmin(left)]), float(np.sqrt(min(left)))


def speed(t_s: Array, p_world_m: Array) -> Signal:
    """Horizontal speed of positions."""
    return t_s, np.linalg.norm(Lines(t_s, HALF_S).slope(p_world_m)[:, :2], axis=1)


def signals(drive: fgloc.Drive, segment: Path | None) -> dict[str, Signal]:
    """The speeds that there are, by name."""
    start_ns, wheel, truth = drive.start_ns, drive.tables["wheel"], drive.truth
    t_fix_s = elapsed_s(drive.gnss.t_ns, start_ns)
    told = {
        "wheels": (elapsed_s(wheel.t_ns, start_ns), wheel.speed_mps),
        "pose": speed(elapsed_s(truth.t_ns, start_ns), truth.p_world_m),
        "fixes": speed(t_fix_s, drive.gnss.p_world_ant_m),
    }
    if segment is not None:
        rows = np.load(segment / "processed_log/GNSS/live_gnss_ublox/value")
        told["receiver's own speed"] = t_fix_s, rows[:, 2]
    return told


def along_the_road(drive: fgloc.Drive) -> None:
    """Print the fixes' mean error along the road, and a line through it over speed."""
    fixes, truth = drive.gnss, drive.truth
    inside = (fixes.t_ns > truth.t_ns[0]) & (fixes.t_ns < truth.t_ns[-1])
    at, z = truth.at(fixes.t_ns[inside]), fixes.p_world_ant_m[inside, :2]
    v = at.v_world_mps[:, :2]
    size = np.linalg.norm(v, axis=1)
    ahead_m = ((z - at.p_world_m[:, :2]) * v).sum(1) / size
    per_mps, constant_m = np.polyfit(size, ahead_m, 1)
    all_s = -ahead_m.mean() / size.mean()
    print(f"along the road the fixes are {ahead_m.mean():+.2f} m off at {size.min():.0f} to "
          f"{size.max():.0f} m/s: {all_s:.3f} s if all of it is lateness; a line says "
          f"{-per_mps:.3f} s and {constant_m:+.2f} m")  # fmt: skip


def main() -> None:
    """Print all three."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("segment", nargs="?", type=Path)
    drive, segment = fgloc.load("comma2k19"), parser.parse_args().segment
    estimates(drive)
    told = signals(drive, segment)
    for name in list(told)[2:]:
        for other in ("wheels", "pose"):
            late_s, left = lag_s(told[name], told[other])
            print(f"{name} later than {other} by {late_s:+.3f} s, {left:.3f} m/s rms left")
    late_s, left = lag_s(told["pose"], told["wheels"])
    print(f"pose later than wheels by {late_s:+.3f} s, {left:.3f} m/s rms left")
    along_the_road(drive)


if __name__ == "__main__":
    main()
