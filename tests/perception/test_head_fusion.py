"""Tracks of two heads as one list: matched in space, joined safely, numbered for good."""

import numpy as np

from fgloc.measurements import PEDESTRIAN, UNKNOWN, VEHICLE
from fgloc.perception.head_fusion import HeadFusion, intersection
from fgloc.perception.settings import HeadsConfig
from fgloc.perception.track_filter import Belief
from fgloc.perception.tracks import Tracks


def tracks(*rows, sigma_m=(0.2, 0.2)):
    """Tracks of rows (number, x, y, kind), and what they tell of."""
    x, P = np.zeros((len(rows), 9)), np.tile(0.01 * np.eye(9), (len(rows), 1, 1))
    for k, (_, east, north, kind) in enumerate(rows):
        x[k, :3], x[k, 5:8] = [east, north, -9.25], [0.5, 0.5, 1.7]
        if kind != PEDESTRIAN:
            x[k, 5:8] = [4.6, 1.85, 1.5]
    P[:, [0, 1], [0, 1]] = np.square(sigma_m)
    made = Tracks.born(Belief(x, P), 0, 0)
    made.id = np.array([row[0] for row in rows], np.int64)
    made.kind = np.array([row[3] for row in rows], np.int64)
    return made, made.belief


def test_one_car_of_two_heads_is_one_object():
    fusion = HeadFusion(HeadsConfig())
    seen = fusion.join([tracks((4, 30.0, 2.0, VEHICLE)), tracks((7, 30.4, 2.1, UNKNOWN))])
    np.testing.assert_allclose(seen.p_node_m, [[30.2, 2.05]], atol=0.21)
    assert (seen.object_id.tolist(), seen.kind.tolist(), seen.heads.tolist()) == (
        [0],
        [VEHICLE],
        [2],
    )


def test_two_cars_stay_two():
    fusion = HeadFusion(HeadsConfig())
    seen = fusion.join([tracks((0, 30.0, 2.0, VEHICLE)), tracks((0, 30.0, -2.0, VEHICLE))])
    assert sorted(seen.object_id.tolist()) == [0, 1]
    assert seen.heads.tolist() == [1, 1]


def test_pedestrians_side_by_side_are_matched_by_their_sigmas():
    fusion = HeadFusion(HeadsConfig(slack_m=0.1))
    left = tracks((0, 20.0, 5.0, PEDESTRIAN), (1, 20.0, 6.5, PEDESTRIAN), sigma_m=(0.3, 0.1))
    right = tracks((0, 20.6, 6.5, PEDESTRIAN), (1, 20.6, 5.0, PEDESTRIAN), sigma_m=(0.3, 0.1))
    seen = fusion.join([left, right])  # 0.6 m apart they have no IoU
    assert len(seen) == 2
    np.testing.assert_allclose(np.sort(seen.p_node_m[:, 1]), [5.0, 6.5], atol=1e-9)


def test_a_number_lasts_while_one_of_the_heads_goes_on():
    fusion = HeadFusion(HeadsConfig())
    fusion.join([tracks((4, 30.0, 2.0, VEHICLE)), tracks((7, 30.1, 2.0, VEHICLE))])
    right = fusion.join([tracks(), tracks((7, 31.0, 2.0, VEHICLE))])
    left = fusion.join([tracks((9, 32.0, 2.0, VEHICLE)), tracks((7, 32.0, 2.0, VEHICLE))])
    alone = fusion.join([tracks((9, 33.0, 2.0, VEHICLE)), tracks()])
    assert [one.object_id.tolist() for one in (right, left, alone)] == [[0], [0], [0]]


def test_no_number_is_given_twice_in_one_frame():
    fusion = HeadFusion(HeadsConfig())
    fusion.join([tracks((0, 30.0, 2.0, VEHICLE)), tracks((0, 30.1, 2.0, VEHICLE))])
    apart = fusion.join([tracks((0, 30.0, 2.0, VEHICLE)), tracks((0, 45.0, 2.0, VEHICLE))])
    assert sorted(apart.object_id.tolist()) == [0, 1]


def test_one_head_alone_is_told_as_it_is():
    fusion = HeadFusion(HeadsConfig())
    head = tracks((3, 30.0, 2.0, VEHICLE), (5, 50.0, 2.0, VEHICLE))
    seen = fusion.join([head])
    np.testing.assert_allclose(seen.p_node_m, head[1].x[:, :2])
    assert seen.object_id.tolist() == [0, 1]
    assert len(fusion.join([tracks()])) == 0


def test_intersection_takes_the_better_of_two_that_are_alike_and_the_best_of_both_axes():
    p = np.zeros((2, 2))
    long, wide = np.diag([4.0, 0.04]), np.diag([0.04, 4.0])
    _, P = intersection(p, np.array([long, np.eye(2)]), p + 0.1, np.array([wide, 4 * np.eye(2)]))
    np.testing.assert_allclose(P[1], np.eye(2), atol=1e-9)
    # Weights of one half: twice what adding information would claim.
    np.testing.assert_allclose(P[0], 2 * np.linalg.inv(np.linalg.inv(long) + np.linalg.inv(wide)))


def test_intersection_claims_no_more_than_is_true_for_any_correlation():
    rng = np.random.default_rng(0)
    P1, P2 = np.diag([1.0, 0.3]), np.diag([0.5, 0.8])
    root1, root2 = np.sqrt(P1), np.sqrt(P2)
    for _ in range(20):
        turn = np.linalg.qr(rng.standard_normal((2, 2)))[0] * rng.uniform(0, 1)
        cross = root1 @ turn @ root2
        joint = np.block([[P1, cross], [cross.T, P2]])
        _, P = intersection(np.zeros((1, 2)), P1[None], np.zeros((1, 2)), P2[None])
        unit = [intersection(e[None, :2], P1[None], e[None, 2:], P2[None])[0][0] for e in np.eye(4)]
        true = np.array(unit).T @ joint @ np.array(unit)
        assert np.linalg.eigvalsh(P[0] - true).min() > -1e-9
