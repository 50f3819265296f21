"""The error-state filter's parts: Jacobians against differences, gates, association, the start."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.baselines.eskf_motion import Inertial, Planar
from fgloc.baselines.eskf_readings import Detections, Fixes, Reading
from fgloc.baselines.eskf_start import _Path, with_slow
from fgloc.baselines.eskf_state import CORE, POSITION, Slow, State
from fgloc.config import GnssConfig, SmoothConfig
from fgloc.drive import GnssBias
from fgloc.frames import exp_so3, log_so3
from fgloc.measurements import EnuVelocities
from fgloc.sync import plan
from fgloc.verdicts import SourceVerdicts

from .roadside import CAR_ID, OTHER_ID, roadside_drive

P_VEH_M = np.array([0.5, -0.2, 0.4])


@pytest.fixture(scope="module")
def drive():
    made = roadside_drive(0, duration_s=40.0, gnss_bias=GnssBias(1.3, 60.0), node_bias_m=0.5)
    node = replace(made.infrastructure.nodes[0], sigma_position_m=0.1, sigma_yaw_rad=0.01)
    return replace(made, infrastructure=replace(made.infrastructure, nodes=(node,)))


@pytest.fixture
def state(drive):
    rng, m = np.random.default_rng(1), len(Slow.of(drive).sigma)
    truth = drive.truth
    k = len(truth) // 2
    return State(
        truth.R_world_veh[k] @ exp_so3([0.02, -0.03, 0.01]), truth.p_world_m[k] + 0.3,
        truth.v_world_mps[k], 0.01 * rng.standard_normal(6), 0.05 * rng.standard_normal(m),
        0.09 * np.eye(CORE + m),
    )  # fmt: skip


def moved(state: State, step) -> State:
    return State(
        state.R @ exp_so3(step[:3]), state.p + state.R @ step[3:6], state.v + step[6:9],
        state.bias + step[9:15], state.slow + step[15:], state.cov,
    )  # fmt: skip


def source(kind, drive):
    verdicts = SourceVerdicts.of(kind.__name__, drive.gnss)
    if kind is Fixes:
        return Fixes(drive, P_VEH_M, GnssConfig(), verdicts)
    return Detections(drive, P_VEH_M, SourceVerdicts.of("detections", drive.tables["detections"]))


@pytest.mark.parametrize("kind", [Fixes, Detections])
def test_jacobians_are_what_differences_give(drive, state, kind):
    own = source(kind, drive)
    slow = state.slow.copy()
    slow[5] = 0.0  # the survey's yaw multiplies the others, which is left out: to second order
    state = replace(state, slow=slow)
    _, H = own.observe(state, 3)
    for i, h in enumerate(np.eye(len(state.cov)) * 1e-6):
        up, down = (own.observe(moved(state, sign * h), 3)[0] for sign in (1, -1))
        np.testing.assert_allclose(H[:, i], (up - down) / 2e-6, atol=1e-6)


def test_the_yaw_of_a_survey_turns_what_is_seen(drive, state):
    exact = replace(state, slow=np.zeros_like(state.slow))
    node = drive.infrastructure.nodes[0]
    turned = replace(node, yaw_rad=node.yaw_rad + 1e-5)
    other = replace(drive, infrastructure=replace(drive.infrastructure, nodes=(turned,)))
    before, H = source(Detections, drive).observe(exact, 3)
    after, _ = source(Detections, other).observe(exact, 3)
    at = Slow.of_node(0)
    np.testing.assert_allclose(H[:, at + 2], (after - before) / 1e-5, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("by", ["imu", "velocity"])
def test_a_step_carries_position_errors_as_its_covariance_says(drive, state, by):
    slow = Slow.of(drive)
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
    assert np.linalg.eigvalsh(after.cov[:9, :9])[0] > 0


def test_an_imu_step_has_the_jacobian_that_differences_give(drive, state):
    motion = Inertial(drive, plan(drive, SmoothConfig()).epochs, SmoothConfig().imu, Slow.of(drive))
    small = replace(state, cov=np.zeros_like(state.cov))
    added = motion.step(5, small).cov
    columns = []
    for h in np.eye(15) * 1e-5:
        a, b = (motion.step(5, moved(small, np.append(s * h, np.zeros(8)))) for s in (1, -1))
        turn = log_so3(b.R.T @ a.R)
        columns.append(np.concatenate([turn, a.R.T @ (a.p - b.p), a.v - b.v]) / 2e-5)
    F = np.array(columns).T
    P = np.diag(np.linspace(0.01, 0.3, 15) ** 2)
    full = np.zeros_like(state.cov)
    full[:15, :15] = P
    given = motion.step(5, replace(state, cov=full)).cov - added
    np.testing.assert_allclose(given[:9, :9], F @ P @ F.T, atol=2e-5)


def test_a_slow_error_is_forgotten_over_its_time_constant(drive):
    phi, variance = Slow.of(drive).step(60.0)
    np.testing.assert_allclose(phi[:3], np.exp(-1))
    np.testing.assert_allclose(variance[:3], 1.69 * (1 - np.exp(-2)))
    np.testing.assert_allclose(phi[3:6], 1)  # a survey stays as wrong as it is
    np.testing.assert_allclose(variance[3:6], 0)


def test_a_start_from_fixes_errs_by_their_slow_error(drive):
    slow = Slow.of(drive)
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


def test_the_followed_object_is_kept_while_it_fits_though_another_is_nearer(drive, state):
    table = drive.tables["detections"]
    own = source(Detections, drive)
    both = np.flatnonzero(np.isin(table.object_id, [CAR_ID, OTHER_ID]))[:2]
    ids = table.object_id.copy()
    ids[both] = [CAR_ID, OTHER_ID]
    place = table.p_node_m.copy()
    error, _ = own.observe(state, int(both[0]))
    place[both[0]] += error + [0.5, 0]
    error, _ = own.observe(state, int(both[1]))
    place[both[1]] += error + [0.1, 0]
    own._table = replace(table, object_id=ids, p_node_m=place)
    one = Reading("detections", 0, 0, both[:1])
    _, taken = own.judge(state, one)
    assert taken.row == both[0]
    _, taken = own.judge(state, Reading("detections", 10**8, 10**8, both))
    assert taken.row == both[0]
    _, taken = own.judge(state, Reading("detections", 3 * 10**9, 3 * 10**9, both))
    assert taken.row == both[1]  # not seen for too long, its number says nothing any more


def test_a_frame_in_which_nothing_fits_is_gated(drive, state):
    far = replace(state, p=state.p + 500.0)
    own = source(Detections, drive)
    after, taken = own.judge(far, Reading("detections", 0, 0, np.array([3, 4])))
    assert taken is None and after is far and own._verdicts.is_("gated").sum() == 2


def test_the_path_of_the_start_has_the_jacobian_that_differences_give():
    rng = np.random.default_rng(3)
    path = _Path(np.linspace(0, 3, 7), np.tile(np.eye(3), (7, 1, 1)), rng.normal(size=(7, 2)),
                 rng.normal(size=(7, 2)), rng.normal(size=(7, 2)))  # fmt: skip
    x = np.array([3.0, -2, 8, 0.7, 0.1, -0.2])
    _, J = path.place(x)
    for i, h in enumerate(np.eye(6) * 1e-6):
        by_hand = (path.place(x + h)[0] - path.place(x - h)[0]) / 2e-6
        np.testing.assert_allclose(J[:, :, i], by_hand, atol=1e-6)


def test_velocities_give_a_heading_only_above_walking_pace():
    t_ns = np.arange(3) * 100_000_000
    table = EnuVelocities(t_ns, t_ns, [[0, 2, 0], [0.5, 0, 0], [-3, 0, 0]], np.full(3, 0.1))
    motion = Planar(table, t_ns, Slow(np.zeros(3), np.ones(3)))
    R, sigma = motion.heading(0)
    np.testing.assert_allclose(R[:, 0], [0, 1, 0], atol=1e-12)
    assert sigma == pytest.approx(np.hypot(0.03, 0.05)) and motion.heading(1) is None
