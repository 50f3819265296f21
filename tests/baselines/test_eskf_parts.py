"""The error-state filter's parts: Jacobians against differences, gates, association, the start."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.baselines.eskf_motion import Inertial, Planar
from fgloc.baselines.eskf_readings import Reading, Readings
from fgloc.baselines.eskf_start import _Path, with_slow
from fgloc.baselines.eskf_state import CORE, POSITION, Slow, State
from fgloc.config import SmoothConfig
from fgloc.drive import GnssBias
from fgloc.frames import exp_so3, log_so3
from fgloc.measurements import EnuVelocities
from fgloc.positions import position_sources
from fgloc.sync import plan

from .roadside import CAR_ID, OTHER_ID, roadside_drive

P_VEH_M = np.array([0.5, -0.2, 0.4])


@pytest.fixture(scope="module")
def drive():
    made = roadside_drive(0, duration_s=40.0, gnss_bias=GnssBias(1.3, 60.0), node_bias_m=0.5)
    node = replace(made.infrastructure.nodes[0], sigma_position_m=0.1, sigma_yaw_rad=0.01)
    return replace(made, infrastructure=replace(made.infrastructure, nodes=(node,)))


@pytest.fixture
def state(drive):
    rng, m = np.random.default_rng(1), len(slow_of(drive).sigma)
    truth = drive.truth
    k = len(truth) // 2
    return State(
        truth.R_world_veh[k] @ exp_so3([0.02, -0.03, 0.01]), truth.p_world_m[k] + 0.3,
        truth.v_world_mps[k], 0.01 * rng.standard_normal(6), 0.05 * rng.standard_normal(m),
        0.09 * np.eye(CORE + m),
    )  # fmt: skip


def slow_of(drive) -> Slow:
    return Slow.of(position_sources(drive, SmoothConfig()))


def moved(state: State, step) -> State:
    return State(
        state.R @ exp_so3(step[:3]), state.p + state.R @ step[3:6], state.v + step[6:9],
        state.bias + step[9:15], state.slow + step[15:], state.cov,
    )  # fmt: skip


def readings(drive) -> Readings:
    planned, sources = plan(drive, SmoothConfig()), position_sources(drive, SmoothConfig())
    return Readings(planned.positions, sources, Slow.of(sources), P_VEH_M, planned.verdicts)


def rows_of(drive, candidate: bool) -> np.ndarray:
    return np.flatnonzero(readings(drive).positions.candidates == candidate)


@pytest.mark.parametrize("candidate", [False, True])
def test_jacobians_are_what_differences_give(drive, state, candidate):
    own, row = readings(drive), int(rows_of(drive, candidate)[3])
    _, H = own.observe(state, row)
    assert len(H) == (2 if candidate else 3)
    for i, h in enumerate(np.eye(len(state.cov)) * 1e-6):
        up, down = (own.observe(moved(state, sign * h), row)[0] for sign in (1, -1))
        np.testing.assert_allclose(H[:, i], (up - down) / 2e-6, atol=1e-6)


def test_what_a_node_is_off_its_survey_shifts_and_turns_what_it_sees(drive, state):
    own, row = readings(drive), int(rows_of(drive, True)[3])
    exact = replace(state, slow=np.zeros(len(state.slow)))
    before, H = own.observe(exact, row)
    node = drive.infrastructure.nodes[0]
    for column, change in enumerate([
        {"p_world_m": node.p_world_m + [1e-5, 0, 0]}, {"p_world_m": node.p_world_m + [0, 1e-5, 0]},
        {"yaw_rad": node.yaw_rad + 1e-5},
    ]):  # fmt: skip
        off = replace(node, **change)
        other = replace(drive, infrastructure=replace(drive.infrastructure, nodes=(off,)))
        after, _ = readings(other).observe(exact, row)
        survey = 15 + 3 + 2 + column  # after the biases of the fixes and the node
        np.testing.assert_allclose(H[:, survey], (after - before) / 1e-5, atol=1e-3)


@pytest.mark.parametrize("by", ["imu", "velocity"])
def test_a_step_carries_position_errors_as_its_covariance_says(drive, state, by):
    slow = slow_of(drive)
    planned = plan(drive, SmoothConfig())
    velocity = drive.tables["velocity"]
    motion = (
        Inertial(drive, planned.epochs, SmoothConfig().imu, slow) if by == "imu"
        else Planar(velocity, planned.epochs.t_ns, slow)
    )  # fmt: skip
    wide = replace(state, cov=1e6 * state.cov)  # what the step adds is lost beside this
    after = motion.step(5, wide)
    step = np.zeros(len(state.cov))
    step[POSITION] = [1e-4, 2e-4, -1e-4]
    apart = motion.step(5, moved(wide, step)).p - after.p
    np.testing.assert_allclose(apart, state.R @ step[POSITION], atol=1e-9)
    assert np.linalg.eigvalsh(motion.told(5, after).cov[:6, :6])[0] > 0


def test_an_imu_step_has_the_jacobian_that_differences_give(drive, state):
    motion = Inertial(drive, plan(drive, SmoothConfig()).epochs, SmoothConfig().imu, slow_of(drive))
    small = replace(state, cov=np.zeros_like(state.cov))
    added = motion.step(5, small).cov
    columns = []
    for h in np.eye(15) * 1e-5:
        a, b = (
            motion.step(5, moved(small, np.append(s * h, np.zeros(len(state.slow)))))
            for s in (1, -1)
        )
        turn = log_so3(b.R.T @ a.R)
        columns.append(np.concatenate([turn, a.R.T @ (a.p - b.p), a.v - b.v]) / 2e-5)
    F = np.array(columns).T
    P = np.diag(np.linspace(0.01, 0.3, 15) ** 2)
    full = np.zeros_like(state.cov)
    full[:15, :15] = P
    given = motion.step(5, replace(state, cov=full)).cov - added
    np.testing.assert_allclose(given[:9, :9], F @ P @ F.T, atol=2e-5)


def test_a_slow_error_is_forgotten_over_its_time_constant(drive):
    phi, variance = slow_of(drive).step(60.0)
    np.testing.assert_allclose(phi[:5], np.exp(-1))
    np.testing.assert_allclose(variance[:3], 1.69 * (1 - np.exp(-2)))
    np.testing.assert_allclose(phi[5:], 1)  # a survey stays as wrong as it is
    np.testing.assert_allclose(variance[5:], 0)


def test_what_a_drive_does_not_state_is_no_unknown():
    assert len(slow_of(roadside_drive(0, duration_s=10.0)).sigma) == 0


def test_a_start_from_fixes_errs_by_their_slow_error(drive):
    slow = slow_of(drive)
    start = with_slow(exp_so3([0, 0, 1.0]), np.zeros(3), np.zeros(3), np.zeros((15, 15)), slow)
    _, H = start.point(np.zeros(3))
    H[:, 15:18] = np.eye(3)
    np.testing.assert_allclose(H @ start.cov @ H.T, 0, atol=1e-12)  # the sum is what was measured


def frame(drive, objects, t_ns=None) -> Reading:
    table = drive.tables["detections"]
    rows = np.flatnonzero(np.isin(table.object_id, objects))
    first = table.t_ns[rows[0]] if t_ns is None else t_ns
    return Reading(
        "detections", int(first), int(first), rows[table.t_ns[rows] == table.t_ns[rows[0]]]
    )


def frame_of_two(drive, state, apart_m) -> tuple[Readings, np.ndarray]:
    """Two candidates, the car and another, so many metres beside where the state is."""
    own = readings(drive)
    rows = rows_of(drive, True)[:2]
    p = own.positions
    z, ids = p.z_world_m.copy(), p.object_id.copy()
    for row, far_m, number in zip(rows, apart_m, (CAR_ID, OTHER_ID), strict=True):
        error, _ = own.observe(state, int(row))
        z[row, :2] += error + [far_m, 0]
        ids[row] = number
    own.positions = replace(p, z_world_m=z, object_id=ids)
    return own, rows


def test_the_number_that_was_the_car_is_kept_though_another_is_a_little_nearer(drive, state):
    own, rows = frame_of_two(drive, state, (0.3, 0.1))
    for _ in range(3):
        _, taken = own.judge(state, Reading(0, 0, rows[:1]))
        assert taken.row == rows[0]
    _, taken = own.judge(state, Reading(0, 0, rows))
    assert taken.row == rows[0]
    verdicts = own._verdicts["detections"]
    assert verdicts.reason[own.positions.row[rows[1]]] == "another candidate of the frame is nearer"


def test_without_a_history_the_nearest_is_the_car(drive, state):
    own, rows = frame_of_two(drive, state, (0.3, 0.1))
    assert own.judge(state, Reading(0, 0, rows))[1].row == rows[1]


def test_a_frame_in_which_nothing_fits_is_gated(drive, state):
    own, rows = frame_of_two(drive, state, (30.0, 40.0))
    after, taken = own.judge(state, Reading(0, 0, rows))
    assert taken is None and after is state
    assert own._verdicts["detections"].is_("gated").sum() == 2


def test_the_path_of_the_start_has_the_jacobian_that_differences_give():
    rng = np.random.default_rng(3)
    path = _Path(np.linspace(0, 3, 7), np.tile(np.eye(3), (7, 1, 1)), rng.normal(size=(7, 2)),
                 rng.normal(size=(7, 2)), rng.normal(size=(7, 2)))  # fmt: skip
    x = np.array([3.0, -2, 8, 0.7, 0.1, -0.2])
    _, J = path.place(x)
    for i, h in enumerate(np.eye(6) * 1e-6):
        by_hand = (path.place(x + h)[0] - path.place(x - h)[0]) / 2e-6
        np.testing.assert_allclose(J[:, :, i], by_hand, atol=1e-6)


def test_velocities_give_a_heading_above_walking_pace_and_it_is_kept_below():
    t_ns = np.arange(3) * 100_000_000
    table = EnuVelocities(t_ns, t_ns, [[0, 2, 0], [0.5, 0, 0], [-3, 0, 0]], np.full(3, 0.1))
    none = np.zeros(0)
    motion = Planar(table, t_ns, Slow(none, none, np.zeros(6, bool)))
    R, sigma = motion.heading(0)
    np.testing.assert_allclose(R[:, 0], [0, 1, 0], atol=1e-12)
    assert (
        sigma == pytest.approx(np.hypot(0.03, 0.05)) and motion.heading(1)[0][1, 0] == 1.0
    )  # kept
    np.testing.assert_allclose(motion.heading(2)[0][:, 0], [-1, 0, 0], atol=1e-12)
