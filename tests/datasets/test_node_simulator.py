"""What a simulated roadside node says of its tracks."""

import numpy as np
import pytest

from fgloc.datasets.node_simulator import Track, line_of_sight_covariance, numbers, simulate_node
from fgloc.datasets.simulator import gauss_markov
from fgloc.infrastructure import Node

NODE = Node("n", np.array([10.0, 20.0, 5.0]), yaw_rad=np.pi / 2)
T_NS = np.arange(3) * 100_000_000


def constant(along_m, across_m):
    return lambda distance_m: (
        np.full(len(distance_m), along_m),
        np.full(len(distance_m), across_m),
    )


def test_sigmas_lie_along_and_across_the_line_of_sight():
    cov_m2 = line_of_sight_covariance(
        np.array([[0.0, 10.0], [3.0, 3.0]]), np.array([2.0, 2.0]), np.array([1.0, 1.0])
    )
    np.testing.assert_allclose(cov_m2[0], [[1, 0], [0, 4]], atol=1e-12)
    np.testing.assert_allclose(cov_m2[1], [[2.5, 1.5], [1.5, 2.5]])


def test_detections_of_all_tracks_come_in_the_order_of_frames_in_the_nodes_axes():
    tracks = [
        Track(np.array([0, 2]), np.array([[10.0, 21.0], [10.0, 23.0]]), np.array([5, 5])),
        Track(np.array([1]), np.array([[7.0, 20.0]]), np.array([8])),
    ]
    noise_free = constant(1e-9, 1e-9)
    table = simulate_node((T_NS, T_NS + 7), NODE, tracks, noise_free, np.random.default_rng(0))
    assert table.object_id.tolist() == [5, 8, 5]
    np.testing.assert_array_equal(table.t_ns, T_NS)
    np.testing.assert_array_equal(table.received_ns, T_NS + 7)
    # The node looks North: its x is North, its y West.
    np.testing.assert_allclose(table.p_node_m, [[1, 0], [0, 3], [3, 0]], atol=1e-6)


def test_noise_has_the_covariance_that_is_stated():
    n = 20_000
    track = Track(np.zeros(n, np.int64), np.tile([14.0, 23.0], (n, 1)), np.zeros(n, np.int64))
    rng = np.random.default_rng(1)
    table = simulate_node((T_NS, T_NS), NODE, [track], constant(0.9, 0.2), rng)
    np.testing.assert_allclose(np.cov(table.p_node_m.T), table.cov_node_m2[0], atol=0.02)


def test_numbers_change_by_chance_and_never_come_back():
    assert numbers(50, 7, 0.0, np.random.default_rng(0)).tolist() == [7] * 50
    changing = numbers(10_000, 7, 0.1, np.random.default_rng(0))
    assert changing[0] == 7
    assert (np.diff(changing) >= 0).all()
    assert np.mean(np.diff(changing)) == pytest.approx(0.1, abs=0.01)


def test_gauss_markov_noise_is_stationary_at_uneven_times_too():
    t_s = np.cumsum(np.tile([0.1, 0.9], 20_000))
    noise = gauss_markov(2.0, t_s, 3, np.random.default_rng(2))
    np.testing.assert_allclose(noise.std(0), 1.0, atol=0.03)
    short, long = noise[1:] * noise[:-1], noise[2:] * noise[:-2]
    assert short[0::2].mean() == pytest.approx(np.exp(-0.45), abs=0.03)
    assert short[1::2].mean() == pytest.approx(np.exp(-0.05), abs=0.03)
    assert long.mean() == pytest.approx(np.exp(-0.5), abs=0.03)
