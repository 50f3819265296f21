"""Epochs of a drive: where the states lie, what the IMU says between them, what was left out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgloc.config import load_config
from fgloc.datasets import make
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.measurements import GnssFixes, ImuSamples, WheelSpeeds
from fgloc.sync import plan
from fgloc.verdicts import Verdict, counts

START_NS = 1_760_000_000_000_000_000
EVERY_10_MS = np.arange(1001) * 0.01
ONCE_A_SECOND = np.arange(11.0)


def ns(seconds) -> np.ndarray:
    return START_NS + np.rint(np.asarray(seconds) * 1e9).astype(np.int64)


def fixes(t_ns) -> GnssFixes:
    n = len(t_ns)
    cov = np.tile(np.eye(3), (n, 1, 1))
    return GnssFixes(t_ns, t_ns, np.zeros((n, 3)), cov, np.full((n, 3), np.nan))


def samples(t_ns, accel=(0.3, -0.2, 9.8), gyro=(0.0, 0.0, 0.0)) -> ImuSamples:
    n = len(t_ns)
    return ImuSamples(t_ns, t_ns, np.tile(accel, (n, 1)), np.tile(gyro, (n, 1)))


def drive_of(gnss, imu, **more) -> Drive:
    return Drive("test", Origin(52.0, 9.0, 100.0), Rig(), {"gnss": gnss, "imu": imu, **more})


def plan_of(fix_s=ONCE_A_SECOND, imu_s=EVERY_10_MS, imu=None, **settings):
    drive = drive_of(fixes(ns(fix_s)), imu or samples(ns(imu_s)))
    return plan(drive, load_config(**settings))


def seconds(t_ns) -> list[float]:
    return ((t_ns - START_NS) / 1e9).tolist()


def changed(table, row, **columns):
    """The table with one row of some columns replaced."""
    arrays = {name: np.array(getattr(table, name)) for name in vars(table)}
    for name, value in columns.items():
        arrays[name][row] = value
    return type(table)(**arrays)


# Where the epochs lie


def test_every_fix_has_its_keyframe():
    made = plan_of(fix_s=[0.5, 1.25, 3.003, 7.0])
    assert seconds(made.positions.t_ns) == [0.5, 1.25, 3.003, 7.0]
    assert made.positions.row.tolist() == [0, 1, 2, 3]
    assert np.isin(made.positions.t_ns, made.epochs.t_ns[made.epochs.is_keyframe]).all()


def test_epochs_reach_from_the_first_fix_to_the_last_sample():
    epochs = plan_of(fix_s=[0.5, 7.0]).epochs
    assert seconds(epochs.t_ns[[0, -1]]) == [0.5, 10.0]
    assert epochs.is_keyframe[[0, -1]].all()


@pytest.mark.parametrize(("keyframe_s", "output_s"), [(1.0, 0.25), (0.7, 0.3), (0.1, 1.0)])
def test_neighbours_are_no_further_apart_than_asked(keyframe_s, output_s):
    epochs = plan_of(
        fix_s=[0, 5, 5.5], keyframe_interval_s=keyframe_s, output_interval_s=output_s
    ).epochs
    keyframes = epochs.t_ns[epochs.keyframes]
    assert np.diff(keyframes).max() <= keyframe_s * 1e9
    assert np.diff(epochs.t_ns).max() <= output_s * 1e9


def test_the_room_between_is_divided_evenly_in_whole_nanoseconds():
    epochs = plan_of(fix_s=[0, 10], keyframe_interval_s=0.7, output_interval_s=0.7).epochs
    lengths = np.diff(epochs.t_ns)
    assert len(lengths) == 15
    assert np.ptp(lengths) <= 1


def test_an_interval_of_just_the_longest_is_not_divided():
    epochs = plan_of(fix_s=ONCE_A_SECOND, keyframe_interval_s=1.0, output_interval_s=1.0).epochs
    assert seconds(epochs.t_ns) == ONCE_A_SECOND.tolist()


# What lies between them


def test_a_sample_at_an_epoch_of_its_own_is_interpolated():
    ramp = EVERY_10_MS[:, None] * [1.0, 2.0, 3.0]
    imu = ImuSamples(ns(EVERY_10_MS), ns(EVERY_10_MS), ramp, np.zeros_like(ramp))
    epochs = plan_of(fix_s=[0.004, 0.017, 5], imu=imu).epochs
    accel, _, dt_s = epochs.samples(1)
    np.testing.assert_allclose(dt_s, [0.006, 0.007], atol=1e-12)
    np.testing.assert_allclose(accel[:, 0], [0.007, 0.0135], atol=1e-12)


def test_the_first_epoch_has_no_samples_before_it():
    assert len(plan_of().epochs.samples(0)[2]) == 0


def test_the_specific_force_at_a_steps_end_is_brought_to_its_beginning():
    rate, force = np.array([0.0, 0.0, 0.5]), np.array([2.0, 1.0, 9.8])
    epochs = plan_of(imu=samples(ns(EVERY_10_MS), force, rate)).epochs
    turned = force + np.cross(rate * 0.01, force)
    np.testing.assert_allclose(epochs.accel_mps2[3], (force + turned) / 2, atol=1e-9)
    np.testing.assert_allclose(epochs.rate_radps, np.tile(rate, (len(epochs), 1)))


def test_samples_are_told_along_the_axes_of_the_vehicle():
    drive = make("city", seed=0, duration_s=10.0)
    R = drive.rig.T_veh_imu[:3, :3]
    epochs = plan(drive, load_config()).epochs
    np.testing.assert_allclose(epochs.rate_radps[0], R @ drive.imu.gyro_radps[0], atol=1e-12)


@st.composite
def irregular(draw):
    """IMU stamps at 1 to 150 ms, and fixes anywhere among them, in ns."""
    steps = draw(st.lists(st.integers(1_000_000, 150_000_000), min_size=20, max_size=80))
    imu = START_NS + np.cumsum([0, *steps])
    inside = st.integers(int(imu[0]), int(imu[-1]))
    fix = draw(st.lists(inside, min_size=2, max_size=12, unique=True))
    return np.array(sorted(fix)), imu


@settings(max_examples=60, deadline=None)
@given(irregular())
def test_nothing_is_lost_or_counted_twice_whatever_the_stamps(stamps):
    fix_ns, imu_ns = stamps
    force, rate = np.array([0.3, -0.2, 9.8]), np.array([0.1, -0.3, 0.2])
    still, turning = samples(imu_ns, accel=force), samples(imu_ns, accel=(0, 0, 0), gyro=rate)
    for imu in (still, turning):
        epochs = plan(drive_of(fixes(fix_ns), imu), load_config()).epochs
        span_s = np.diff(epochs.t_ns) / 1e9
        parts = [epochs.samples(k) for k in range(1, len(epochs))]
        assert (epochs.dt_s > 0).all()
        np.testing.assert_allclose([dt.sum() for _, _, dt in parts], span_s, atol=1e-9)
        gained = np.sum([(a * dt[:, None]).sum(0) for a, _, dt in parts], axis=0)
        turned = np.sum([(w * dt[:, None]).sum(0) for _, w, dt in parts], axis=0)
        np.testing.assert_allclose(gained, imu.accel_mps2[0] * span_s.sum(), atol=1e-8)
        np.testing.assert_allclose(turned, imu.gyro_radps[0] * span_s.sum(), atol=1e-8)


# Gaps


def with_gap(first_s=4.0, last_s=6.5) -> np.ndarray:
    t_s = EVERY_10_MS
    return t_s[(t_s <= first_s) | (t_s >= last_s)]


def test_a_gap_has_keyframes_at_both_ends_and_lies_in_intervals_of_its_own():
    epochs = plan_of(fix_s=[0, 5.2, 9], imu_s=with_gap()).epochs
    at = np.array(seconds(epochs.t_ns))
    np.testing.assert_array_equal(epochs.in_gap, (at > 4.0) & (at <= 6.5))
    assert {4.0, 5.2, 6.5} <= set(at[epochs.is_keyframe].tolist())


def test_a_gap_is_told():
    (event,) = plan_of(imu_s=with_gap()).events
    assert (event.t_ns, event.kind) == (START_NS + 4 * 10**9, "imu gap")
    assert "2.50 s" in event.text


def test_a_gap_before_the_first_fix_matters_to_nobody():
    made = plan_of(fix_s=[7, 8, 9], imu_s=with_gap())
    assert made.events == ()
    assert not made.epochs.in_gap.any()


def test_a_first_fix_within_a_gap_begins_there():
    made = plan_of(fix_s=[5, 8, 9], imu_s=with_gap())
    assert [event.t_ns for event in made.events] == [START_NS + 5 * 10**9]
    assert made.epochs.in_gap[1]


# Verdicts


def verdict_of_row(row, **columns):
    gnss = changed(fixes(ns(ONCE_A_SECOND)), row, **columns)
    made = plan(drive_of(gnss, samples(ns(EVERY_10_MS))), load_config()).verdicts["gnss"]
    return made.verdict[row], made.reason[row]


@pytest.mark.parametrize(
    ("columns", "verdict", "reason"),
    [
        ({"p_world_ant_m": np.nan}, Verdict.INVALID, "not finite"),
        ({"cov_world_m2": np.inf}, Verdict.INVALID, "not finite"),
        ({"cov_world_m2": np.zeros((3, 3))}, Verdict.INVALID, "not positive definite"),
        ({"cov_world_m2": np.diag([1, -1, 1])}, Verdict.INVALID, "not positive definite"),
        ({"t_ns": START_NS + 3 * 10**9}, Verdict.DUPLICATE, "earlier row has the same t_ns"),
        ({}, Verdict.UNUSED, "not reached"),
    ],
)
def test_a_fix_that_cannot_enter_is_told_why(columns, verdict, reason):
    got, why = verdict_of_row(4, **columns)
    assert got == verdict
    assert reason in why


def test_a_fix_outside_the_imus_time_is_outside():
    made = plan_of(fix_s=[-1, 0, 5, 11]).verdicts["gnss"]
    assert made.is_(Verdict.OUTSIDE).tolist() == [True, False, False, True]
    assert made.reason[0] == "no IMU samples at this time"


def test_a_sound_fix_stands_in_for_an_invalid_one_of_the_same_instant():
    gnss = changed(fixes(ns([0, 3, 3, 3, 6])), 1, p_world_ant_m=np.nan)
    made = plan(drive_of(gnss, samples(ns(EVERY_10_MS))), load_config())
    expected = [Verdict.UNUSED, Verdict.INVALID, Verdict.UNUSED, Verdict.DUPLICATE, Verdict.UNUSED]
    assert made.verdicts["gnss"].verdict.tolist() == expected
    assert made.positions.row.tolist() == [0, 2, 4]


def test_a_sample_that_is_not_finite_is_invalid_and_stepped_over():
    imu = changed(samples(ns(EVERY_10_MS)), 300, accel_mps2=np.nan)
    made = plan(drive_of(fixes(ns(ONCE_A_SECOND)), imu), load_config())
    assert made.verdicts["imu"].counts() == {"invalid": 1, "used": 1000}
    assert np.isfinite(made.epochs.accel_mps2).all()
    assert made.epochs.dt_s.sum() == pytest.approx(10.0)


def test_many_such_samples_are_a_gap():
    imu = changed(samples(ns(EVERY_10_MS)), slice(300, 340), gyro_radps=np.nan)
    made = plan(drive_of(fixes(ns(ONCE_A_SECOND)), imu), load_config())
    assert [event.kind for event in made.events] == ["imu gap"]


def test_an_imu_of_nothing_but_nan_is_refused():
    imu = samples(ns(EVERY_10_MS), accel=(np.nan, 0, 0))
    with pytest.raises(DriveError, match="none of its 1001 IMU samples is finite"):
        plan(drive_of(fixes(ns(ONCE_A_SECOND)), imu), load_config())


def test_samples_before_the_first_fix_are_outside():
    made = plan_of(fix_s=[2.005, 5, 6]).verdicts["imu"]
    assert made.counts() == {"outside": 200, "used": 801}
    assert made.reason[0] == "before the first usable fix"


def test_a_table_without_a_factor_is_unused():
    config = load_config()
    made = plan(make("city", seed=1, duration_s=10.0), config).verdicts["wheel"]
    assert set(made.verdict) == {Verdict.UNUSED}
    assert set(made.reason) == {"no wheel factor in this method"}


def test_verdicts_add_up_to_the_rows_read():
    gnss = fixes(ns([-1, 0, 1, 1, 2, 3, 12]))
    wheel = WheelSpeeds(ns([1, 2]), ns([1, 2]), np.zeros(2), np.ones(2))
    imu = changed(samples(ns(EVERY_10_MS)), 5, gyro_radps=np.inf)
    drive = drive_of(gnss, imu, wheel=wheel)
    told = counts(plan(drive, load_config()).verdicts)
    assert {name: sum(told[name].values()) for name in told} == {"gnss": 7, "imu": 1001, "wheel": 2}


@pytest.mark.parametrize(("fix_s", "usable"), [([5.0], 1), ([18, 19, 20], 0), ([-3, 4], 1)])
def test_fewer_than_two_usable_fixes_point_to_the_clocks(fix_s, usable):
    message = rf"'test': {usable} of {len(fix_s)} GNSS fixes .* GPS is 18 s ahead of UTC"
    with pytest.raises(DriveError, match=message):
        plan_of(fix_s=fix_s)


def test_a_drive_without_imu_is_refused_where_one_is_asked_for():
    drive = Drive("test", Origin(52.0, 9.0, 0.0), Rig(), {"gnss": fixes(ns([1, 2]))})
    with pytest.raises(DriveError, match=r"'test' has no imu rows \(it has gnss\)"):
        plan(drive, load_config(motion={"kind": "imu"}))
    assert plan(drive, load_config()).motion.kind == "constant-velocity"
