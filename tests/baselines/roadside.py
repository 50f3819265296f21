"""A city drive past a roadside node, with a second car, ghosts and slowly varying errors."""

from dataclasses import replace

import numpy as np

from fgloc.datasets.city import GNSS_SIGMA_ENU_M, IMU_HZ, ORIGIN, city_motion, city_rig
from fgloc.datasets.simulator import (
    Motion,
    gauss_markov,
    simulate_gnss,
    simulate_imu,
    stream,
    truth_of,
)
from fgloc.drive import Drive, GnssBias
from fgloc.factors.detection import LEE2021_ACROSS_M, lee2021_sigma_m, line_of_sight_cov_m2
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import VEHICLE, Array, EnuVelocities, NodeDetections
from fgloc.timing import seconds_to_ns

BOX_M = (1.4, 0.0, 0.8)
SIGMA_V_MPS, FLOOR_M = 0.1, 0.3
SECOND_CAR_BEHIND_S = 1.5
GHOST_ID, CAR_ID, OTHER_ID = 90, 7, 8


def roadside_drive(
    seed: int, *, duration_s: float = 60.0, latency_s: float = 0.0, ghosts: bool = True,
    gnss_bias: GnssBias | None = None, node_bias_m: float = 0.0, box_m: Array = BOX_M,
) -> Drive:  # fmt: skip
    """A node 12 m beside the street at half time; ids change once, on the way."""
    motion = city_motion(seed, duration_s)
    rig = replace(city_rig(), p_veh_box_m=np.array(box_m), gnss_bias=gnss_bias)
    slow = motion.every(IMU_HZ // 10)
    middle = len(slow) // 2
    beside = slow.p_world_m[middle] + slow.R_world_veh[middle] @ [0, 12.0, 5.0]
    node = Node("pole", beside, 0.7, range_m=60.0, bias_sigma_m=node_bias_m, bias_tau_s=60.0)
    gnss = simulate_gnss(slow, rig, GNSS_SIGMA_ENU_M, stream(seed, "gnss"))
    if gnss_bias is not None:
        wander = _wander(len(slow), gnss_bias.sigma_m, gnss_bias.tau_s, 3, seed)
        gnss = replace(gnss, p_world_ant_m=gnss.p_world_ant_m + wander)
    tables = {
        "gnss": gnss,
        "imu": simulate_imu(motion, rig, ORIGIN.gravity_mps2(), stream(seed, "imu")),
        "velocity": _velocities(slow, stream(seed, "velocity")),
        "detections": _detections(slow, node, rig.p_veh_box_m, latency_s, ghosts, seed),
    }
    return Drive("roadside", ORIGIN, rig, tables, truth_of(motion.every(5)),
                 infrastructure=Infrastructure((node,)))  # fmt: skip


def _wander(n: int, sigma_m: float, tau_s: float, axes: int, seed: int) -> Array:
    """A slow error (n, axes) at 10 Hz."""
    return sigma_m * gauss_markov(tau_s, np.arange(n) / 10, axes, stream(seed, f"slow {axes}"))


def _velocities(motion: Motion, rng: np.random.Generator) -> EnuVelocities:
    v = motion.v_world_mps + SIGMA_V_MPS * rng.standard_normal(motion.v_world_mps.shape)
    return EnuVelocities(motion.t_ns, motion.t_ns, v, np.full(len(v), SIGMA_V_MPS))


def _detections(
    motion: Motion, node: Node, box_m: Array, latency_s: float, ghosts: bool, seed: int
) -> NodeDetections:
    rng = stream(seed, "detections")
    place = node.from_world((motion.p_world_m + motion.R_world_veh @ box_m)[:, :2])
    if node.bias_sigma_m:
        place = place + _wander(len(place), node.bias_sigma_m, node.bias_tau_s, 2, seed)
    seen = np.linalg.norm(place, axis=1) < 55
    late = round(SECOND_CAR_BEHIND_S * 10)
    behind = np.roll(place, late, axis=0)
    rows = [(k, CAR_ID if k < len(motion) // 2 else CAR_ID + 10, place[k])
            for k in np.flatnonzero(seen)]  # fmt: skip
    if ghosts:
        rows += [(k, OTHER_ID, behind[k]) for k in np.flatnonzero(np.roll(seen, late))]
        rows += [(k, GHOST_ID + k, place[k] + 12 * rng.standard_normal(2))
                 for k in np.flatnonzero(seen) if k % 7 == 0]  # fmt: skip
    rows.sort(key=lambda row: row[0])
    p = np.array([row[2] for row in rows]).reshape(-1, 2)
    along = lee2021_sigma_m(np.linalg.norm(p, axis=1), FLOOR_M)
    cov = line_of_sight_cov_m2(p, along, LEE2021_ACROSS_M)
    p = p + np.einsum("nij,nj->ni", np.linalg.cholesky(cov), rng.standard_normal(p.shape))
    t_ns = motion.t_ns[[row[0] for row in rows]]
    n = len(rows)
    return NodeDetections(
        t_ns, t_ns + seconds_to_ns(latency_s), np.zeros(n, np.int64),
        np.array([row[1] for row in rows]), np.full(n, VEHICLE), p, np.full((n, 2, 2), np.nan),
    )  # fmt: skip
