"""Posts beside a car in its graph: slots, steps, what is told, and both solvers alike."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import U
from hypothesis import given
from hypothesis import strategies as st

import fgloc
from fgloc.config import load_config
from fgloc.drive import About, Drive, Rig
from fgloc.errors import InputError
from fgloc.factors.post import ROUNDING, axis_step, post_spread, post_step, whitened_steps
from fgloc.factors.sway import compensated
from fgloc.infrastructure import Infrastructure, Node, Post
from fgloc.measurements import LEFT_OUT, NodeDetections, NodePoses
from fgloc.smoother.chain import Chain
from fgloc.smoother.guess import guess, yaw_by_turns
from fgloc.smoother.model import Model
from fgloc.smoother.native_posts import post_key, told_factors
from fgloc.smoother.post_evidence import log_density, with_posts
from fgloc.smoother.states import Robustness, States
from fgloc.smoother.swaying import Swaying, _slots, occurrence
from fgloc.smoother.term import Step, Term
from fgloc.sync import plan
from fgloc.verdicts import Verdict
from fgloc.watches import beside_cars

POST = Post("a", 10.0, 1.97, 0.05, 20.0, 0.1377, 90.0, 0.7)
SCENARIO = "khamooshi2023/sway-drive"
T_NS = np.arange(6) * 100_000_000


@pytest.fixture(scope="module")
def drive():
    return fgloc.make(SCENARIO, seed=5, duration_s=8.0, users=1)


@pytest.fixture(scope="module")
def high():
    """A LiDAR that tells heights, and a user who does."""
    return fgloc.make(SCENARIO, seed=5, duration_s=8.0, users=1, sensor="lidar")


def two_posts(seen_s=(0.0, 0.1, 0.4, 0.5), nodes=(0, 0, 1, 1)) -> Drive:
    """Two nodes on posts of which the one sees something before the other does; a pose of each."""
    t_ns = np.round(np.array(seen_s) * 1e9).astype(np.int64)
    n = len(t_ns)
    seen = NodeDetections(t_ns, t_ns, nodes, np.zeros(n), np.ones(n), np.tile([30.0, 4.0], (n, 1)),
                          np.tile(np.eye(2), (n, 1, 1)))  # fmt: skip
    unknown = np.full((2, 2), np.nan)
    poses = NodePoses(t_ns[[0, -1]], t_ns[[0, -1]], [0, 1], [[0.1, 0.2], [0.3, 0.4]],
                      unknown, np.full((2, 2), 0.1), unknown)  # fmt: skip
    posts = (POST, replace(POST, node="b", frequency_hz=1.2))
    beside = Infrastructure(tuple(Node(name, np.array([0, 0, 10.0])) for name in "ab"), posts)
    return Drive("two", fgloc.Origin(0, 0, 0), Rig(), {"detections": seen, "node_poses": poses},
                 None, About("two"), beside)  # fmt: skip


def swaying_of(drive: Drive) -> Swaying:
    seen = drive.tables["detections"]
    watches = beside_cars(drive, load_config(), seen.node, seen.t_ns, seen.t_ns[[0, -1]])
    return Swaying(drive, watches, T_NS)


def test_posts_that_do_not_see_at_once_share_a_slot():
    swaying = swaying_of(two_posts())
    assert (swaying.slots, swaying.width) == (1, 6)
    assert swaying.owner[:, 0].tolist() == [0, 0, 0, 0, 1, 1]
    assert swaying.begins[:, 0].tolist() == [True, False, False, False, True, False]
    after, before = swaying.steps
    assert not before[4].any()
    np.testing.assert_allclose(np.linalg.inv(after[4, 0].T @ after[4, 0]),
                               post_spread(swaying.watches[1].post), atol=1e-12)  # fmt: skip


def test_what_is_told_of_a_post_stands_at_its_keyframe_and_in_its_slot():
    swaying = swaying_of(two_posts())
    ((slot, keys, z, J),) = swaying.poses(0, 6)
    assert (slot, keys.tolist()) == (0, [0, 5])
    # Over a sigma of 0.1 m; angles are not told.
    np.testing.assert_allclose(z, [[1, 2, 0, 0], [3, 4, 0, 0]])
    np.testing.assert_allclose(J[0, :, [0, 3]], [[10, 0, 0, 0], [0, 10, 0, 0]])
    assert not list(swaying.poses(1, 5))


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=12))
def test_spans_of_one_slot_do_not_touch(pairs):
    spans = np.array([sorted(pair) for pair in pairs])
    slot = _slots(spans)
    inside = np.array([[a <= t <= b for a, b in spans] for t in range(10)])
    assert slot.max() + 1 == inside.sum(1).max()
    for c in range(slot.max() + 1):
        assert inside[:, slot == c].sum(1).max() <= 1


def test_equal_values_are_counted_on():
    assert occurrence(np.array([3, 1, 3, 3, 1])).tolist() == [0, 0, 1, 2, 1]
    assert len(occurrence(np.zeros(0, int))) == 0


def test_many_steps_at_once_are_those_one_by_one():
    dt_s = np.array([0.1, 0.003, 0.1, 4.0])
    after, before = whitened_steps(POST, dt_s)
    noise = np.linalg.inv(after.swapaxes(-1, -2) @ after)
    added = np.diag(np.tile(ROUNDING, 2) ** 2)
    for k, dt in enumerate(dt_s.tolist()):
        step = post_step(POST, dt)
        np.testing.assert_allclose(-np.linalg.inv(after[k]) @ before[k], step.transition, atol=1e-9)
        np.testing.assert_allclose(noise[k], step.noise + added, rtol=1e-9, atol=1e-15)
    assert np.diag(axis_step(POST, 0.1).noise).min() > 1e4 * ROUNDING[0] ** 2


def test_a_microsecond_between_two_keyframes_can_be_solved():
    after, before = whitened_steps(POST, np.array([1e-6]))
    assert np.linalg.cond(after[0]) < 1e4
    np.testing.assert_allclose(-np.linalg.inv(after[0]) @ before[0], np.eye(6), atol=1e-3)


def every_other_height(drive):
    """The drive with every second frame telling no heights."""
    seen = drive.tables["detections"]
    told = np.arange(len(seen)) % 4 < 2
    up, sigma = (np.where(told, column, np.nan) for column in (seen.up_node_m, seen.sigma_up_m))
    return drive.with_tables(detections=replace(seen, up_node_m=up, sigma_up_m=sigma))


def test_a_row_has_the_degrees_of_freedom_that_it_tells(high):
    mixed = every_other_height(high)
    for mode in ("batch", "fixed-lag"):
        judged = fgloc.smooth(mixed, mode).verdicts["detections"]
        weighed = np.isfinite(judged.nis)
        told = np.where(mixed.tables["detections"].has_height, 3, 2)
        np.testing.assert_array_equal(judged.dof[weighed], told[weighed])
        gates = [load_config().detections.gate_nis(dof) for dof in (2, 3)]
        np.testing.assert_allclose(judged.threshold[weighed], np.array(gates)[told[weighed] - 2])
        assert set(told[weighed]) == {2, 3}
        mean = judged.nis[weighed] / told[weighed]
        assert mean[judged.is_(Verdict.USED)[weighed]].mean() == pytest.approx(1.0, abs=0.3)


def test_a_height_holds_the_car_where_fixes_hardly_do(high):
    flat = fgloc.make(SCENARIO, seed=5, duration_s=8.0, users=1, sensor="lidar", heights=False)
    up_m = [fgloc.smooth(drive).trajectory.p_world_m[:, 2] for drive in (high, flat)]
    errors = [np.sqrt(np.mean(up**2)) for up in up_m]
    assert errors[0] < 0.06 and errors[0] < errors[1] / 3


def test_sway_left_out_is_said_where_heights_are_told(high):
    def told(drive, *settings):
        events = fgloc.smooth(drive, settings=settings).events
        return [event.text for event in events if event.kind == "post"]

    (text,) = told(high, "posts.compensate=false")
    assert text.startswith("node 'isn-1': its post is left out: heights that it tells are taken")
    assert not told(high)
    bare = replace(high.tables["detections"], up_node_m=LEFT_OUT, sigma_up_m=LEFT_OUT)
    assert not told(high.with_tables(detections=bare), "posts.compensate=false")


@pytest.mark.parametrize("sensor", ["camera", "lidar"])
def test_what_a_known_sway_moves_is_exact_and_so_is_its_jacobian(drive, high, sensor):
    drive = every_other_height(high) if sensor == "lidar" else drive
    nodes = (replace(drive.infrastructure.nodes[0], yaw_rad=0.4),)
    drive = replace(drive, infrastructure=replace(drive.infrastructure, nodes=nodes))
    swaying = Swaying(drive, plan(drive, load_config()).posts, T_NS)
    row = np.array([0, 43, 76])
    states = 0.02 * np.random.default_rng(0).standard_normal((3, 6))
    moved, J = swaying.moved(1, row, states)
    seen_m, post = drive.tables["detections"].place_node_m[row], drive.infrastructure.posts[0]
    sway = np.stack([states[:, 0], states[:, 3], -post.tip_slope_per_m * states[:, 3],
                     post.tip_slope_per_m * states[:, 0]], -1)  # fmt: skip
    still = compensated(seen_m, sway, post.height_m, sensor)
    world_m = nodes[0].place_to_world(still) - nodes[0].place_to_world(seen_m)
    np.testing.assert_allclose(moved, np.nan_to_num(world_m), atol=1e-12)
    assert (np.abs(moved[:, 2]) > 1e-9).tolist() == np.isfinite(seen_m[:, 2]).tolist()
    for k, step in enumerate(1e-6 * np.eye(6)):
        ahead, back = (swaying.moved(1, row, states + sign * step)[0] for sign in (1, -1))
        np.testing.assert_allclose((ahead - back) / 2e-6, J[:, :, k], atol=1e-6)


def test_a_tilt_beyond_the_horizon_is_followed_in_a_straight_line(drive):
    swaying = Swaying(drive, plan(drive, load_config()).posts, T_NS)
    one, two = (swaying.moved(1, np.array([0]), f * np.eye(6)[:1])[0] for f in (50.0, 100.0))
    assert np.isfinite(one).all()
    assert np.linalg.norm(two) == pytest.approx(2 * np.linalg.norm(one), rel=0.1)


def test_the_native_factors_of_a_user_charge_the_residual():
    rng = np.random.default_rng(1)
    told, z, state, J = *rng.standard_normal((2, 3)), rng.standard_normal(6), np.ones((3, 6))
    cov = np.array([[2, 1, 0], [1, 3.0, 0], [0, 0, 0.5]])
    model = gtsam.noiseModel.Gaussian.Covariance(cov)
    tie, row = told_factors(0, told, z, model, {post_key(1, 4): J})
    values = gtsam.Values()
    values.insert(post_key(1, 4), state)
    values.insert(U(0), z - J @ state)
    assert row.error(values) == pytest.approx(0, abs=1e-12)
    off = told - (z - J @ state)
    assert tie.error(values) == pytest.approx(off @ np.linalg.solve(cov, off) / 2)


@pytest.fixture(scope="module")
def solved(drive):
    return both_solutions(drive)


def both_solutions(drive):
    """By the chain and by GTSAM."""
    return [fgloc.smooth(drive, settings=[f"solver.batch={name}"]) for name in ("banded", "gtsam")]


@pytest.fixture(scope="module", params=["heights", "every other height", "uncertain survey"])
def solved_high(high, request):
    """Of a LiDAR: one that tells all heights, or some, or whose place and yaw are not certain."""
    drive = high
    if request.param == "every other height":
        drive = every_other_height(high)
    if request.param == "uncertain survey":
        (node,) = high.infrastructure.nodes
        off = {"sigma_position_m": 0.3, "sigma_yaw_rad": 0.01, "sigma_level_rad": 0.005}
        nodes = (replace(node, bias_sigma_m=0.1, **off),)
        drive = replace(high, infrastructure=replace(high.infrastructure, nodes=nodes))
    return both_solutions(drive)


def test_gtsam_and_the_chain_find_the_same_posts_and_the_same_car(solved):
    assert_same_solution(*solved)


def test_they_do_so_where_a_lidar_tells_heights(solved_high):
    assert_same_solution(*solved_high)


def assert_same_solution(ours, theirs):
    assert ours.summary["cost"] == pytest.approx(theirs.summary["cost"], abs=0.01)
    np.testing.assert_allclose(ours.posts.p_node_m, theirs.posts.p_node_m, atol=1e-5)
    np.testing.assert_allclose(ours.posts.sigma_p_m, theirs.posts.sigma_p_m, rtol=1e-3)
    np.testing.assert_allclose(ours.trajectory.p_world_m, theirs.trajectory.p_world_m, atol=2e-3)
    for source in ("node_poses", "detections"):
        nis = [one.verdicts[source].nis for one in (ours, theirs)]
        np.testing.assert_allclose(*nis, rtol=0.01, atol=1e-2)
        dof = [one.verdicts[source].dof for one in (ours, theirs)]
        np.testing.assert_array_equal(*dof)


def test_every_row_has_its_verdict(solved, drive):
    for result in solved:
        counts = result.summary["counts"]
        assert counts["node_poses"] == {"used": 81}
        assert counts["users"] == {"used": 81}
        assert sum(counts["detections"].values()) == len(drive.tables["detections"])
        reasons = result.verdicts["detections"].reason
        assert any("user 101, who says where it is" in reason for reason in reasons)


def test_left_out_posts_leave_the_poses_unused(drive):
    result = fgloc.smooth(drive, settings=["posts.compensate=false"])
    assert result.posts is None
    assert result.summary["counts"]["node_poses"] == {"unused": 81}


def test_poses_when_a_node_sees_nothing_are_not_used():
    drive = fgloc.make(SCENARIO, seed=5, duration_s=25.0)
    seen = drive.tables["detections"]
    early = drive.with_tables(detections=seen.take(seen.t_ns - seen.t_ns[0] <= 4 * 10**9))
    judged = fgloc.smooth(early).verdicts["node_poses"]
    used = judged.is_(Verdict.USED)
    assert judged.t_ns[used][-1] - judged.t_ns[0] == 14 * 10**9
    assert set(judged.reason[~used]) == {"nothing that the node saw then is in the graph"}


def with_post(drive, **numbers):
    (post,) = drive.infrastructure.posts
    beside = replace(drive.infrastructure, posts=(replace(post, **numbers),))
    return replace(drive, infrastructure=beside)


def test_frequency_and_damping_are_found_from_passing_cars_alone():
    """No pose of the node: a car with GPS of a metre and one with RTK."""
    true = fgloc.make(SCENARIO, seed=0, duration_s=20.0, poses=False, users=1)
    wrong = with_post(true, frequency_hz=2.3, damping=0.15)
    told = fgloc.smooth(wrong, settings=["posts.estimate_mode=true"]).summary["posts_sought"]
    found = told["isn-1"]["frequency_hz"]
    assert found["stated"] == 2.3
    assert abs(found["value"] / 1.965 - 1) < 4 * found["relative_error"] < 0.2
    assert told["isn-1"]["damping"]["value"] < 0.15


def test_the_density_of_a_chain_is_that_of_its_dense_system():
    """By the formula, from determinants of dense matrices: what two posts differ by."""
    drive = fgloc.make(SCENARIO, seed=1, duration_s=2.0)
    model = Model(drive, plan(drive, load_config()), load_config())
    deltas, _ = model.deltas()
    start = guess(model, 0, len(model) - 1, yaw_by_turns(model))
    chain, states = Chain(model, start, deltas), States.of(start, model)
    robust = Robustness(np.zeros(len(model.positions), bool), np.inf, plain=True)

    def dense(one: Chain) -> float:
        J, e = whole_system(one, states, robust)
        step = np.linalg.lstsq(J, -e, rcond=None)[0]
        cost = np.sum((e + J @ step) ** 2) / 2
        after = one.model.swaying.steps[0]
        return -cost - np.linalg.slogdet(J.T @ J)[1] / 2 + np.linalg.slogdet(after)[1].sum()

    posts = [replace(model.plan.posts[0].post, frequency_hz=f) for f in (1.8, 2.1)]
    chains = [with_posts(chain, (replace(model.plan.posts[0], post=post),)) for post in posts]
    ours = np.diff([log_density(one, states, robust) for one in chains])
    assert ours == pytest.approx(np.diff([dense(one) for one in chains]), rel=1e-3)


def whole_system(chain: Chain, states: States, robust: Robustness):
    """Jacobian and errors of all terms; the copies of a bias are left as separate unknowns."""
    rows, errors = [], []
    for factor in chain.at(states, robust, 0, chain.n):
        term = as_term(factor, chain.width) if isinstance(factor, Step) else factor
        for block, jacobian, error in zip(term.blocks, term.jacobian, term.error, strict=True):
            J = np.zeros((len(error), (chain.n + 1) * chain.width))
            J[:, block * chain.width + term.at] = jacobian
            rows.append(J[:, : chain.n * chain.width])
            errors.append(error)
    return np.concatenate(rows), np.concatenate(errors)


@pytest.mark.parametrize(("mode", "settings", "match"), [
    ("fixed-lag", [], "goes with mode batch"),
    ("batch", ["solver.batch=gtsam"], "goes with solver.batch = banded"),
])  # fmt: skip
def test_who_cannot_seek_a_post_says_so(drive, mode, settings, match):
    with pytest.raises(InputError, match=match):
        fgloc.smooth(drive, mode, settings=["posts.estimate_mode=true", *settings])


def as_term(step: Step, width: int) -> Term:
    """A step's errors and Jacobians written out."""
    eye = np.tile(np.eye(len(step.at)), (len(step.blocks), 1, 1))
    J = np.concatenate([-step.phi[:, None, None] * eye, eye], -1) / step.sigma[..., None]
    return Term(step.blocks, np.append(step.at, width + step.at), step.change / step.sigma, J)
