"""How late each source's stamps are: set right, made better by an estimate, and told of.

What is estimated is how much later each source that is asked for is stamped than the trajectory,
whose clock is that of all others. The IMU carries the trajectory, so its lateness is that of all
others seen from the other side.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.config import Clock, SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import ConfigError
from fgloc.measurements import Array
from fgloc.motion import Kind
from fgloc.timing import seconds_to_ns
from fgloc.verdicts import Verdicts

OBSERVABLE_SHARE = 0.5
"""A lateness counts as observed where its sigma has come down to this share of the prior's."""
TABLES = {
    "gnss": ("gnss",), "imu": ("imu",), "wheel": ("wheel", "odometry"), "steering": ("steering",),
    "velocity": ("velocity",), "nodes": ("detections", "node_poses"),
}  # fmt: skip
"""The tables whose stamps are of one clock."""


def on_time(drive: Drive, config: SmoothConfig) -> Drive:
    """The drive with its rows at the instants when they were true; received as they were."""
    late_s = {
        table: getattr(config.clock, f"{name}_s")
        for name, tables in TABLES.items()
        for table in tables
    }
    tables = {
        name: replace(drive.tables[name], t_ns=drive.tables[name].t_ns - seconds_to_ns(s))
        for name, s in late_s.items()
        if s and name in drive.tables
    }
    return drive.with_tables(**tables) if tables else drive


def stamped_as_read(verdicts: Verdicts, drive: Drive) -> Verdicts:
    """Verdicts with the stamps that the rows came with."""
    for name, table in drive.tables.items():
        verdicts[name].t_ns = table.t_ns
    return verdicts


def acting(config: SmoothConfig, table: str) -> NDArray[np.int64]:
    """Which of the estimated latenesses, by their order, add up to that of a table that aids."""
    names = config.clock.estimate
    return np.array([i for i, name in enumerate(names) if name == "imu" or table in TABLES[name]],
                    np.int64)  # fmt: skip


def shifted(config: SmoothConfig, late_s: Array) -> SmoothConfig:
    """The configuration that makes up for latenesses (k,) of the estimated sources, as `acting`
    adds them up."""
    clock = config.clock
    change = dict(zip(clock.estimate, late_s.tolist(), strict=True))
    if "imu" in change:
        change["imu"] *= -1
    at_fault = {f"{name}_s": getattr(clock, f"{name}_s") + by for name, by in change.items()}
    return config.model_copy(update={"clock": clock.model_copy(update=at_fault)})


def summary(found: SmoothConfig, sigma_s: Array) -> dict[str, dict[str, Any]]:
    """What is told of each estimated lateness (k,), and of how sure that is, by source."""
    told = zip(found.clock.estimate, sigma_s.tolist(), strict=True)
    return {source: _told(found, source, sigma) for source, sigma in told}


def _told(found: SmoothConfig, source: Clock, sigma_s: float) -> dict[str, Any]:
    late_s: float = getattr(found.clock, f"{source}_s")
    observable = sigma_s < OBSERVABLE_SHARE * found.clock.sigma_s
    text = f"{source} stamps are {round(late_s, 3) + 0.0:.3f} s late (sigma {sigma_s:.2g} s)"
    if not observable:
        text += "; the drive hardly shows it: it turns and changes speed too little"
    return {"late_s": late_s, "sigma_s": sigma_s, "observable": observable, "text": text}


def refuse_causal(config: SmoothConfig) -> None:
    """Raise ConfigError where a causal run is asked to estimate what takes the whole drive."""
    if names := config.clock.estimate:
        raise ConfigError(
            "clock.estimate goes with mode batch; run it once and give a causal run what it finds "
            f"as {', '.join(f'clock.{name}_s' for name in names)}"
        )


def refuse_unanchored(config: SmoothConfig, aids: Sequence[str], motion: Kind) -> None:
    """Raise ConfigError where a clock is asked for that nothing else can be held against.

    aids    the clocks of what is in use beside the motion
    motion  what carries the states
    """
    names = config.clock.estimate
    for name in names:
        if name == "imu" and motion != "imu":
            raise ConfigError(
                f"clock.estimate = imu: states are carried by {motion}, not by an IMU"
            )
        if name == "wheel" and motion in ("odometry", "bicycle"):
            raise ConfigError(
                f"clock.estimate = wheel: states are carried by {motion}, whose clock is then "
                "that of the trajectory; estimate the clocks of the others, e.g. gnss"
            )
        if name not in ("imu", *aids):
            raise ConfigError(
                f"clock.estimate = {name}: nothing of it is in use (in use: {', '.join(aids)}); "
                "leave it out, or switch it on, e.g. vehicle.wheel_speed=true"
            )
    if set(aids) <= set(names) and (motion == "constant-velocity" or "imu" in names):
        raise ConfigError(
            f"clock.estimate = {','.join(names)}: one of these clocks must be that of the "
            "trajectory, or all could be shifted together; leave one out"
        )
