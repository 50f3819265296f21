"""How late a source's stamps are: set right, made better by an estimate, and told of."""

from dataclasses import replace
from typing import Any

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import ConfigError
from fgloc.timing import seconds_to_ns
from fgloc.verdicts import Verdicts

OBSERVABLE_SHARE = 0.5
"""A lateness counts as observed where its sigma has come down to this share of the prior's."""


def on_time(drive: Drive, config: SmoothConfig) -> Drive:
    """The drive with its rows at the instants when they were true; received as they were."""
    clock = config.clock
    late_s = {"gnss": clock.gnss_s, "imu": clock.imu_s, "wheel": clock.wheel_s,
              "detections": clock.nodes_s}  # fmt: skip
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


def shifted(config: SmoothConfig, late_s: float) -> SmoothConfig:
    """The configuration that makes up for positions which are so much later than the IMU."""
    clock = config.clock
    key = f"{clock.estimate}_s"
    sign = -1 if clock.estimate == "imu" else 1
    at_fault = {key: getattr(clock, key) + sign * late_s}
    return config.model_copy(update={"clock": clock.model_copy(update=at_fault)})


def summary(found: SmoothConfig, sigma_s: float) -> dict[str, Any]:
    """What is told of an estimated lateness, and of how sure that is."""
    source = found.clock.estimate
    late_s: float = getattr(found.clock, f"{source}_s")
    observable = sigma_s < OBSERVABLE_SHARE * found.clock.sigma_s
    text = f"{source} stamps are {round(late_s, 3) + 0.0:.3f} s late (sigma {sigma_s:.2g} s)"
    if not observable:
        text += "; the drive hardly shows it: it turns and changes speed too little"
    return {"source": source, "late_s": late_s, "sigma_s": sigma_s, "observable": observable,
            "text": text}  # fmt: skip


def refuse_estimate(config: SmoothConfig) -> None:
    """Raise ConfigError where a causal run is asked to estimate what takes the whole drive."""
    if config.clock.estimate != "none":
        name = config.clock.estimate
        raise ConfigError(
            f"clock.estimate goes with mode batch; run it once and give a causal run what it finds "
            f"as clock.{name}_s"
        )


def refuse_wheels(config: SmoothConfig) -> None:
    """Raise ConfigError where wheels, on a clock of their own, would hide how late others are."""
    if config.clock.estimate != "none" and config.vehicle.wheel_speed:
        raise ConfigError(
            "clock.estimate and vehicle.wheel_speed = true do not go together: estimate without "
            "the wheels, and give what it finds to a run with them"
        )
