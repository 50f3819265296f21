"""Scenario `lee2021/mcity`: a car with GPS and IMU drives past a roadside node three times.

After W. Lee et al., "Infrastructure node-based vehicle localization for autonomous driving"
(arXiv 2109.10457, 2021), sections III-D and IV: 300 s at the Mcity test track, one node, three
passes, each through a tunnel; something hides the car for a moment in the second and third. The
road is in `lee2021_road.py`, the errors that make the paper's tables come out in
`lee2021_errors.py`.

| source | rate | error |
|---|---|---|
| gnss | 10 Hz | white as stated, slow as in `lee2021_errors.py`; the rig states its rms |
| imu | 100 Hz | white with walking biases, as the rig states |
| velocity | 10 Hz | white; in the paper what the IMU gives, its error is not told |
| detections | 10 Hz | white as stated, slow as in `lee2021_errors.py`; the node states its rms |

Frames of the node are true at the instants of the fixes, so both share states of the graph, and
arrive `latency_s` later on average. Beside the car there are a second one that follows it,
and ghosts. Numbers of objects change now and then, and always when the node loses the car.
The truth is of the rear axle on the ground, at 50 Hz with attitude and velocity.
"""

import math
from dataclasses import replace

import numpy as np

from fgloc.datasets import lee2021_road as road
from fgloc.datasets.city import city_rig
from fgloc.datasets.lee2021_errors import (
    GNSS_BIAS,
    GPS_WHITE_ENU_M,
    NODE_BIAS_SIGMA_M,
    NODE_BIAS_TAU_S,
    PAPER,
    PaperErrors,
    check_errors,
    gps_slow_m,
    node_slow_m,
    node_white_m,
    turned,
)
from fgloc.datasets.lee2021_traffic import tracks
from fgloc.datasets.node_simulator import simulate_node
from fgloc.datasets.simulator import (
    Motion,
    simulate_gnss,
    simulate_imu,
    simulate_velocity,
    stream,
    truth_of,
)
from fgloc.drive import About, Drive, Rig
from fgloc.errors import InputError
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import Array
from fgloc.timing import NS_PER_S, Instants, elapsed_s

NAME = "lee2021/mcity"
TRUTH_HZ, FUSION_HZ = 50, 10
VELOCITY_SIGMA_MPS = 0.2

P_VEH_BOX_M = (1.35, 0.0, 0.75)
P_VEH_ANT_M = (P_VEH_BOX_M[0] - 0.0381, 0.0, 1.5)
"""Half a wheelbase ahead of the rear axle: the box's centre is where the paper's reference is,
0.0381 m ahead of the GPS (18)."""

LATENCY_S = 0.1
LATENCY_SPREAD = 0.3
"""The delay of a frame is uniform within this share of the mean either way."""
LONGEST_LATENCY_S = 10.0


def make_lee2021_mcity(seed: int = 0, errors: str = "paper", latency_s: float = LATENCY_S) -> Drive:
    """The drive of a seed.

    errors     'paper': as in the paper's tables, with tunnel, ghosts and a second car; 'turned':
               the same with biases that point anywhere in each pass; 'model': exactly as the drive
               states them, of the car alone
    latency_s  mean delay of the node's frames

    Raises InputError for a seed below 0, unknown errors or a latency outside [0 s, 10 s].
    """
    check_errors(errors)
    if not (math.isfinite(latency_s) and 0 <= latency_s <= LONGEST_LATENCY_S):
        raise InputError(f"latency_s = {latency_s}: expected 0 to {LONGEST_LATENCY_S:g} seconds")
    return simulate(seed, errors, latency_s)


def simulate(
    seed: int, errors: str = "paper", latency_s: float = LATENCY_S, paper: PaperErrors = PAPER
) -> Drive:
    """As `make_lee2021_mcity`, with other magnitudes and directions of the errors 'paper'."""
    paper = turned(seed, paper) if errors == "turned" else paper
    rig, node, motion = mcity_rig(), mcity_node(), road.motion()
    epochs = motion.every(road.RATE_HZ // FUSION_HZ)
    t_s = elapsed_s(epochs.t_ns, road.START_NS)
    from_node_m = (epochs.p_world_m - node.p_world_m)[:, :2]
    gps_m = gps_slow_m(t_s, from_node_m, cases(), errors, seed, paper)
    node_m = node_slow_m(t_s, cases(), errors, seed, paper)
    white = simulate_gnss(epochs, rig, GPS_WHITE_ENU_M, stream(seed, "gnss"))
    followed = tracks(_box_m(epochs, rig), node_m, t_s, node, cases(), errors != "model", seed)
    frames_ns = epochs.t_ns, _received_ns(epochs.t_ns, latency_s, seed)
    tables = {
        "gnss": replace(white, p_world_ant_m=white.p_world_ant_m + gps_m),
        "imu": simulate_imu(motion, rig, road.origin().gravity_mps2(), stream(seed, "imu")),
        "velocity": simulate_velocity(epochs, VELOCITY_SIGMA_MPS, stream(seed, "velocity")),
        "detections": simulate_node(frames_ns, node, followed, node_white_m, stream(seed, "node")),
    }
    truth = truth_of(motion.every(road.RATE_HZ // TRUTH_HZ))
    about = _about(seed, errors, latency_s)
    return Drive(NAME, road.origin(), rig, tables, truth, about, Infrastructure((node,)))


def mcity_rig() -> Rig:
    """Antenna and box half a wheelbase ahead of the rear axle, the IMU that of `city`."""
    antenna_m, box_m = np.array(P_VEH_ANT_M), np.array(P_VEH_BOX_M)
    return replace(city_rig(), p_veh_ant_m=antenna_m, p_veh_box_m=box_m, gnss_bias=GNSS_BIAS)


def mcity_node() -> Node:
    """The node where the paper has it; its axes are East and North."""
    return Node(
        "ix-node", road.node_place_m(), range_m=road.NODE_RANGE_M,
        bias_sigma_m=NODE_BIAS_SIGMA_M, bias_tau_s=NODE_BIAS_TAU_S,
    )  # fmt: skip


def cases() -> tuple[road.Case, ...]:
    """The paper's three cases: the passes by the node, in seconds from the drive's start."""
    return road.cases(np.array(P_VEH_BOX_M), mcity_node())


def _box_m(epochs: Motion, rig: Rig) -> Array:
    """(N, 2) centre of the car's box, East and North."""
    return (epochs.p_world_m + epochs.R_world_veh @ rig.p_veh_box_m)[:, :2]


def _received_ns(t_ns: Instants, latency_s: float, seed: int) -> Instants:
    share = stream(seed, "node/latency").uniform(1 - LATENCY_SPREAD, 1 + LATENCY_SPREAD, len(t_ns))
    return t_ns + np.rint(latency_s * share * NS_PER_S).astype(np.int64)


def _about(seed: int, errors: str, latency_s: float) -> About:
    return About(
        title=f"Simulated car passing a roadside node three times (Lee et al. 2021), seed {seed}",
        licence="MIT",
        source=(f"fgloc scenario {NAME}, seed {seed}, errors {errors}, latency_s {latency_s:g}"),
        simulated=True,
    )
