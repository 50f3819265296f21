"""Scenarios `khamooshi2023/sway-low` and `sway-high`: a node on a post that sways in the wind.

Khamooshi (2023), section 3.8.4. No vehicle drives by: a post of the paper's aluminium, 10 m high,
200 mm wide and 5 mm thick, swings under a load, and a pose estimator says ten times a second where
the node is. The motion is integrated at 200 Hz and then sampled, so that what is too fast for the
estimator is there and can mislead.

The paper's load (-1.5 to 1 kN), its post and its motion (10 cm in x, 15 cm in y) contradict each
other; here the motion is binding and the load is scaled to give it. The pose noise is white and of
the size with which the largest error of the estimates alone is, in the median of 600 samples, what
the paper reports: 4 and 6 cm (low), 3 and 7 cm (high). Its angles are good to 2 % of their
amplitude, that is 0.3 mrad in y at most: over the post's slope such an angle alone tells the
displacement to 2 mm. `tilt_noise` makes the angles worse by a factor, `wind = "kaimal"` replaces
the sines by gusts.
"""

from dataclasses import dataclass

import numpy as np

from fgloc.datasets.simulator import instants, stream
from fgloc.datasets.wind import gusts, sines
from fgloc.drive import About, Drive, Rig
from fgloc.errors import InputError
from fgloc.factors.bending import HollowPost, mass_damping_per_s, post_of
from fgloc.factors.post import oscillator, tilt_rad
from fgloc.frames import Origin
from fgloc.infrastructure import Infrastructure, Node, Post
from fgloc.measurements import Array, NodePoses
from fgloc.posts import PostStates
from fgloc.timing import NS_PER_S, Instants

START_NS = 1_760_000_000 * NS_PER_S
ORIGIN = Origin(43.4723, -80.5449, 330.0)
NODE = Node("isn-1", np.array([0.0, 0.0, 10.0]))
BEAM = HollowPost(height_m=10.0, diameter_m=0.2, wall_m=0.005)
DAMPING = 0.05
"""# Differs from the paper: it states none. This gives alpha = 1.23, within 1 < alpha < 2 w of
Eq. (3.25); welded aluminium has 0.5 to 2 %, which is not."""
MOTION_HZ, POSE_HZ = 200, 10
WARM_UP_S, SHORTEST_S, LONGEST_S = 20.0, 1.0, 3600.0

AMPLITUDE_M = (0.10, 0.15)
TILT_SHARE = 0.02
MEDIAN_MAX_OF_600 = 3.25
"""The median of the largest of 600 absolute standard normal numbers."""


@dataclass(frozen=True)
class Case:
    """One wind of the paper: the frequencies of the load, the largest errors of the estimates
    alone along x and y, and what the drive states of the load: its sigma and memory."""

    frequencies_hz: tuple[float, ...]
    largest_error_m: tuple[float, float]
    load_n_s: tuple[float, float]


# What is stated of the loads is what makes the poses of seeds 100 to 102 likeliest.
LOW = Case((0.5, 1.0), (0.04, 0.06), (170.0, 0.5))
HIGH = Case((1.0, 3.0, 10.0), (0.03, 0.07), (250.0, 0.05))
GUSTS_N_S = (90.0, 0.7)
WINDS = ("sines", "kaimal")


def make_sway_low(
    seed: int = 0, duration_s: float = 60.0, wind: str = "sines", tilt_noise: float = 1.0
) -> Drive:
    """Sway under a load at 0.5 and 1 Hz. Raises InputError for options that cannot be."""
    return _make("khamooshi2023/sway-low", LOW, seed, duration_s, wind, tilt_noise)


def make_sway_high(
    seed: int = 0, duration_s: float = 60.0, wind: str = "sines", tilt_noise: float = 1.0
) -> Drive:
    """Sway under a load at 1, 3 and 10 Hz. Raises InputError for options that cannot be."""
    return _make("khamooshi2023/sway-high", HIGH, seed, duration_s, wind, tilt_noise)


def _make(
    name: str, case: Case, seed: int, duration_s: float, wind: str, tilt_noise: float
) -> Drive:
    check_duration(duration_s)
    t_ns = instants(START_NS, duration_s, MOTION_HZ)
    post, truth, peak_n = simulate_sway(case, wind, t_ns, stream(seed, "load"))
    poses = simulate_poses(truth, case, post, tilt_noise, stream(seed, "poses"))
    source = f"fgloc scenario {name}, seed {seed}, duration_s {duration_s:g}, wind {wind}"
    title = (
        f"Simulated sway of a post of {post.frequency_hz:.2f} Hz, damping {post.damping:g} (alpha "
        f"{mass_damping_per_s(2 * np.pi * post.frequency_hz, post.damping):.2f} 1/s), under at "
        f"most {peak_n / 1000:.2f} kN, seed {seed}"
    )
    return Drive(
        name, ORIGIN, Rig(), {"node_poses": poses}, None, About(title, "MIT", source, True),
        Infrastructure((NODE,), (post,)), post_truth=truth,
    )  # fmt: skip


def simulate_sway(
    case: Case, wind: str, t_ns: Instants, rng: np.random.Generator
) -> tuple[Post, PostStates, float]:
    """The post under a wind, how it sways at instants `MOTION_HZ` apart, and the largest load in N.

    Raises InputError for an unknown wind.
    """
    if wind not in WINDS:
        raise InputError(f"wind = {wind!r}: expected one of {', '.join(WINDS)}")
    post = post_of(NODE.name, BEAM, DAMPING, *(GUSTS_N_S if wind == "kaimal" else case.load_n_s))
    p_m, v_mps, peak_n = _swing(post, _load(case, wind, len(t_ns), rng), len(t_ns))
    tilt = tilt_rad(p_m, post.tip_slope_per_m)
    return post, PostStates.truth(t_ns, 0, p_m, v_mps, tilt), peak_n


def simulate_poses(
    truth: PostStates, case: Case, post: Post, tilt_noise: float, rng: np.random.Generator
) -> NodePoses:
    """What the pose estimator says, ten times a second; InputError for an impossible factor."""
    if not (np.isfinite(tilt_noise) and tilt_noise > 0):
        raise InputError(f"tilt_noise = {tilt_noise}: expected a factor above 0")
    at = truth.take(slice(None, None, MOTION_HZ // POSE_HZ))
    n = len(at)
    sigma_p_m = np.array(case.largest_error_m) / MEDIAN_MAX_OF_600
    largest = np.abs(tilt_rad(np.array([AMPLITUDE_M]), post.tip_slope_per_m))[0]
    sigma_tilt = tilt_noise * TILT_SHARE * largest / MEDIAN_MAX_OF_600
    return NodePoses(
        at.t_ns, at.t_ns, at.node, at.p_node_m + sigma_p_m * rng.standard_normal((n, 2)),
        at.tilt_rad + sigma_tilt * rng.standard_normal((n, 2)), np.tile(sigma_p_m, (n, 1)),
        np.tile(sigma_tilt, (n, 1)),
    )  # fmt: skip


def check_duration(duration_s: float) -> None:
    """Raise InputError where a scenario would be too short or too long."""
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        raise InputError(
            f"duration_s = {duration_s}: expected {SHORTEST_S:g} to {LONGEST_S:g} seconds"
        )


def _load(case: Case, wind: str, n: int, rng: np.random.Generator) -> Array:
    """Shape (warm-up + n, 2) of the load along x and y at the rate of the motion."""
    n += int(WARM_UP_S * MOTION_HZ)
    if wind == "kaimal":
        return gusts(n, MOTION_HZ, rng)
    return sines(np.arange(n) / MOTION_HZ, case.frequencies_hz, rng)


def _swing(post: Post, load: Array, n: int) -> tuple[Array, Array, float]:
    """Displacement m and velocity m/s (n, 2) under a load that is scaled to give the amplitudes,
    once the start is forgotten; and the largest load in N. Exact for a load of straight pieces."""
    from scipy.signal import cont2discrete, lfilter, ss2tf

    A = oscillator(post.frequency_hz, post.damping)
    system = (A, np.array([[0.0], [1 / post.modal_mass_kg]]), np.eye(2), np.zeros((2, 1)))
    *sampled, _ = cont2discrete(system, 1 / MOTION_HZ, "foh")
    answers, ring_down = ss2tf(*sampled)
    state = np.stack([lfilter(answer, ring_down, load, axis=0)[-n:] for answer in answers], 1)
    scale = np.array(AMPLITUDE_M) / np.abs(state[:, 0]).max(0)
    return state[:, 0] * scale, state[:, 1] * scale, float(np.abs(load[-n:] * scale).max())
