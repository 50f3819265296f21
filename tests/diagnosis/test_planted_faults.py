"""Each fault that is planted in a clean drive is found, by its right name, and nothing in none."""

import dataclasses
from functools import cache

import numpy as np
import pytest

import fgloc
from fgloc.datasets.degrade import degrade
from fgloc.diagnosis import diagnose

from .faults import CITY_FAULTS, FAULTS, RTK_FAULTS

NOT_FAULTS = {"sigma far too large"}
"""What may as well be right: errors that drift slowly scatter less than they are."""


@cache
def city(seed, duration_s):
    return fgloc.make("city", seed=seed, duration_s=duration_s)


@cache
def rtk():
    return fgloc.load("mems-rtk")


def found_of(drive, planted):
    return [
        one for one in diagnose(planted.plant(drive))
        if (one.check, one.source) == (planted.check, planted.source)
        and planted.words in f"{one.what} {one.remedy}"
    ]  # fmt: skip


def worse_than_remark(drive):
    return [one for one in diagnose(drive) if one.severity != "remark"]


@cache
def rtk_part():
    """Four minutes with stops and turns."""
    first_ns = rtk().start_ns + 150_000_000_000
    parts = {
        name: table.take((table.t_ns >= first_ns) & (table.t_ns < first_ns + 240_000_000_000))
        for name, table in rtk().tables.items()
    }
    return rtk().with_tables(**parts)


@pytest.mark.parametrize("name", FAULTS | CITY_FAULTS)
def test_a_fault_in_a_simulated_drive_is_found(name):
    found = found_of(city(17, 60.0), (FAULTS | CITY_FAULTS)[name])
    assert found
    assert name in NOT_FAULTS or found[0].severity != "remark"
    assert all(one.remedy for one in found)


@pytest.mark.parametrize("name", FAULTS | RTK_FAULTS)
def test_a_fault_in_a_recorded_drive_is_found(name):
    found = found_of(rtk_part(), (FAULTS | RTK_FAULTS)[name])
    assert found
    assert name in NOT_FAULTS or found[0].severity != "remark"


@pytest.mark.parametrize(
    "name", ["imu in g", "imu axes z-down", "gyro reversed", "imu stamped in ms"]
)
def test_a_fault_has_one_name(name):
    """What follows from a fault is not told of as another one."""
    for drive in (city(17, 60.0), rtk_part()):
        findings = worse_than_remark(FAULTS[name].plant(drive))
        assert {one.check for one in findings} == {FAULTS[name].check}


@pytest.mark.parametrize("seed", [2, 31, 77])
@pytest.mark.parametrize("duration_s", [20.0, 120.0])
def test_a_clean_simulated_drive_has_no_fault(seed, duration_s):
    assert not worse_than_remark(city(seed, duration_s))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"outage": (75, 15, 45)},
        {"outage": (75, 30, 90)},
        {"noise_enu_m": (1, 1, 2), "seed": 3},
        {"noise_enu_m": (3, 3, 5), "outage": (75, 15, 45)},
        {"keep_every": 2},
    ],
)
def test_a_clean_recorded_drive_has_no_fault_with_or_without_outages_and_noise(options):
    drive = degrade(rtk(), **options) if options else rtk()
    assert not worse_than_remark(drive)


def test_a_clean_drive_without_truth_or_turns_has_no_fault():
    drive = dataclasses.replace(city(31, 60.0), truth=None)
    assert not worse_than_remark(drive)
    first_fixes = drive.gnss.t_ns < drive.start_ns + 15_000_000_000
    short = drive.with_tables(gnss=drive.gnss.take(first_fixes))
    assert not worse_than_remark(short)


def test_objects_of_one_frame_and_a_stated_bias_of_the_fixes_are_no_fault():
    drive = fgloc.make("lee2021/mcity", seed=1)
    assert not worse_than_remark(drive)
    unstated = dataclasses.replace(drive, rig=dataclasses.replace(drive.rig, gnss_bias=None))
    assert [one.check for one in worse_than_remark(unstated)] == ["truth-offset"]


def test_a_stray_fix_is_one_finding():
    """It does not bend the motion by which all else is judged."""
    findings = worse_than_remark(FAULTS["a stray fix"].plant(rtk_part()))
    assert [one.check for one in findings] == ["outlier"]


def test_a_turned_imu_is_found_on_a_straight_road():
    """Only speeding up and braking tell."""
    drive = straight(FAULTS["imu turned by a quarter"].plant)
    assert [one.check for one in worse_than_remark(drive)] == ["imu-axes"]
    assert not worse_than_remark(straight(lambda drive: drive))


def straight(plant):
    """Speeding up and braking eastwards, told by exact fixes and a perfect IMU."""
    t_s = np.arange(0, 90, 0.02)
    speed, push = 12 + 6 * np.sin(0.3 * t_s), 1.8 * np.cos(0.3 * t_s)
    t_ns, zero, n = city(31, 60.0).start_ns + np.round(t_s * 1e9).astype(int), 0 * t_s, len(t_s)
    p_world_ant_m = np.stack([12 * t_s - 20 * np.cos(0.3 * t_s), zero, zero], -1)
    rng = np.random.default_rng(3)
    accel = np.stack([push, zero, zero + 9.81], -1) + 1e-2 * rng.standard_normal((n, 3))
    fixes = fgloc.GnssFixes(
        t_ns, t_ns, p_world_ant_m + 0.02 * rng.standard_normal((n, 3)),
        np.tile(np.eye(3) * 4e-4, (n, 1, 1)), np.tile(np.nan, (n, 3)),
    )  # fmt: skip
    imu = fgloc.ImuSamples(t_ns, t_ns, accel, 1e-3 * rng.standard_normal((n, 3)))
    assert speed.min() > 5
    rig = fgloc.Rig(imu_noise=fgloc.ImuNoise(1e-2, 1e-3, 1e-3, 1e-4))
    return plant(
        fgloc.Drive(
            "straight",
            fgloc.Origin(52, 9, 0),
            rig,
            {"gnss": fixes.take(slice(None, None, 10)), "imu": imu},
        )
    )


def test_a_minute_of_a_clean_recording_shows_no_lag():
    """Slopes and springs look like a lag of tenths over a few bends."""
    fixes, samples = rtk().gnss, rtk().imu
    for first in range(0, len(fixes) - 90, 90):
        part = fixes.take(slice(first, first + 90))
        inside = (samples.t_ns >= part.t_ns[0]) & (samples.t_ns <= part.t_ns[-1])
        drive = rtk().with_tables(gnss=part, imu=samples.take(inside))
        assert not worse_than_remark(drive)


@pytest.mark.parametrize("rows", [0, 1, 2, 30])
def test_a_drive_with_hardly_a_row_is_checked_all_the_same(rows):
    tables = {name: table.take(slice(rows)) for name, table in city(31, 60.0).tables.items()}
    findings = diagnose(city(31, 60.0).with_tables(**tables))
    assert any(one.check == "no-rows" for one in findings) is (rows < 2)


def test_a_drive_of_nothing_but_nan_is_checked_all_the_same():
    drive = city(31, 60.0)
    fixes, samples = drive.gnss, drive.imu
    nothing = drive.with_tables(
        gnss=dataclasses.replace(fixes, p_world_ant_m=np.nan * fixes.p_world_ant_m),
        imu=dataclasses.replace(samples, accel_mps2=np.nan * samples.accel_mps2),
    )
    checks = {(one.source, one.check) for one in diagnose(nothing) if one.severity == "fault"}
    assert {("gnss", "not-finite"), ("imu", "not-finite")} <= checks
