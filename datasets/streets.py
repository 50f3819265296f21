"""Streets for simulated sensors: a plain one with traffic, and the second pass of `lee2021/mcity`.

The plain street runs along the node's x axis, which looks East: the node hangs over the middle,
between two lanes; beside them are pavements and houses. Cars keep their lane and speed; those of
one lane drive alike, so that none runs into another.
"""

from collections.abc import Callable

import numpy as np

from fgloc.datasets import lee2021, lee2021_road
from fgloc.datasets.simulator import instants, stream
from fgloc.datasets.street_recording import record, straight_solids
from fgloc.errors import InputError
from fgloc.frames import Origin, yaw_of
from fgloc.infrastructure import Node
from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.heads import PerceptionNode
from fgloc.perception.paper_nodes import HEIGHT_M, lee2021_node
from fgloc.perception.recording import Recording
from fgloc.perception.street import CAR_SIZE_M, PERSON_SIZE_M, Mover, Solids, Street, Sway
from fgloc.timing import NS_PER_S, Instants, elapsed_s, seconds_to_ns

NAME, MCITY_NAME = "street", "street/mcity"
START_NS = 1_600_000_000_000_000_000
ORIGIN = Origin(42.3, -83.7, 240.0)
RATE_HZ = 10
NODE = Node("street-node", np.array([0.0, 0.0, HEIGHT_M]))

STREET_M = (0.0, 110.0)
"""Where traffic begins and ends, East of the node."""
LANES = ((-2.2, 0.0), (2.2, np.pi))
"""North of the node, and which way they lead."""
PAVEMENTS_M = (-5.5, 5.5)
LANE_MPS, WALK_MPS = (6.0, 14.0), (0.8, 1.8)
CAR_GAP_M, WALK_GAP_M = (14.0, 40.0), (15.0, 40.0)
"""From one to the next of a lane."""
SIZE_SPREAD = 0.05
"""Standard deviation of a size as a share of it."""
PALETTE = ((40, 40, 190), (200, 120, 40), (230, 230, 230), (30, 30, 30), (60, 160, 60),
           (150, 150, 155), (40, 170, 210))  # fmt: skip
"""Of cars and coats: blue, green, red."""
HOUSES = ((8, 30, 8, 16, 0, 9), (36, 58, 8, 18, 0, 12), (66, 112, 8, 16, 0, 8),
          (5, 40, -18, -8, 0, 10), (48, 72, -16, -8, 0, 7), (80, 112, -18, -8, 0, 11),
          (20, 20.3, -4.5, -4.2, 0, 7), (60, 60.3, 4.2, 4.5, 0, 7))  # fmt: skip
"""And two lamp posts: along x, along y, above the ground, m."""

SWAY_HZ, SWAY_SLOPE_RADPM = 0.8, 0.14
"""Of the simulated sway: frequency and tilt for each metre that the tip moves."""

MCITY_SOLIDS = ((-26, -8, -15.0, -14.5, 0, 5), (-26, -8, -15.0, -6.0, 4.6, 5.0),
                (3, 7, -6.2, -5.0, 0, 4), (-60, 60, -32, -24, 0, 8))  # fmt: skip
"""The tunnel's southern wall and roof, a lorry that hides the stretch `OCCLUDED_M`, houses: East
and North of the node, above the ground, m."""
MCITY_CASE, MCITY_MARGIN_S = 1, 4.0
CAR_ID, FOLLOWER_ID = 1, 2
FOLLOWING_S = 2.0


def plain_street(
    seed: int, duration_s: float = 20.0, sway_m: float = 0.0,
    make_node: Callable[[Node], PerceptionNode] = lee2021_node,
) -> Street:  # fmt: skip
    """The plain street with the traffic of a seed.

    sway_m     amplitude of the node's tip, along both axes; it tilts with it
    make_node  from the survey to the node with its heads

    Raises InputError for a seed below 0, or a duration or sway that is none.
    """
    if not (0 < duration_s < np.inf and 0 <= sway_m < np.inf):
        raise InputError(
            f"duration_s = {duration_s}, sway_m = {sway_m}: expected above 0, 0 or more"
        )
    rng, node = stream(seed, "street"), make_node(NODE)
    movers: list[Mover] = []
    for y_m, yaw_rad in LANES:
        speed_mps = rng.uniform(*LANE_MPS)
        movers += _lane(rng, VEHICLE, y_m, yaw_rad, speed_mps, duration_s, len(movers))
    for y_m in PAVEMENTS_M:
        yaw_rad, speed_mps = rng.choice([0.0, np.pi]), rng.uniform(*WALK_MPS)
        movers += _lane(rng, PEDESTRIAN, y_m, yaw_rad, speed_mps, duration_s, len(movers))
    fixed = Solids(*straight_solids(HOUSES, node.ground_m))
    sway = _sway(rng, duration_s, sway_m) if sway_m else None
    return Street(node, fixed, tuple(movers), sway)


def _lane(
    rng: np.random.Generator, kind: int, y_m: float, yaw_rad: float, speed_mps: float,
    duration_s: float, first_id: int,
) -> list[Mover]:  # fmt: skip
    """All that passes along one line while it lasts, one behind the other."""
    car = kind == VEHICLE
    first_m, last_m = STREET_M if np.cos(yaw_rad) > 0 else STREET_M[::-1]
    gap_m = CAR_GAP_M if car else WALK_GAP_M
    length_m, way_m = abs(last_m - first_m), speed_mps * duration_s
    # How far before the street's beginning each is at the start; those on it already are negative.
    before_m = np.cumsum(rng.uniform(*gap_m, int((length_m + way_m) / gap_m[0]) + 1)) - length_m
    p_m = np.array([[first_m, y_m], [last_m, y_m]])
    movers = []
    for number, enter_m in enumerate(before_m[before_m < way_m], start=first_id + 1):
        span_s = np.array([enter_m, enter_m + length_m]) / speed_mps
        t_ns = START_NS + np.rint(span_s * NS_PER_S).astype(np.int64)
        spread = 1 + SIZE_SPREAD * np.clip(rng.standard_normal(3), -2, 2)
        length, width, height = spread * (CAR_SIZE_M if car else PERSON_SIZE_M)
        colour, yaws_rad = PALETTE[rng.integers(len(PALETTE))], np.full(2, yaw_rad)
        movers.append(Mover(number, kind, t_ns, p_m, yaws_rad, (length, width, height), colour))
    return movers


def _sway(rng: np.random.Generator, duration_s: float, sway_m: float) -> Sway:
    """Sines of the post's first mode along both axes, out of phase."""
    t_ns = instants(START_NS, duration_s + 1.0, 50)
    phase = rng.uniform(0, 2 * np.pi, 2)
    t_s = elapsed_s(t_ns, START_NS)
    plan_m = sway_m * np.sin(2 * np.pi * SWAY_HZ * t_s[:, None] + phase)
    tilt_rad = SWAY_SLOPE_RADPM * np.column_stack([-plan_m[:, 1], plan_m[:, 0]])
    level = np.zeros((len(t_ns), 1))
    return Sway(t_ns, np.hstack([plan_m, level]), np.hstack([tilt_rad, level]))


def make_street(
    seed: int = 0, duration_s: float = 20.0, sway_m: float = 0.0,
    make_node: Callable[[Node], PerceptionNode] = lee2021_node,
) -> Recording:  # fmt: skip
    """A recording of the plain street at 10 Hz; errors as of `plain_street`."""
    street = plain_street(seed, duration_s, sway_m, make_node)
    return record(NAME, street, ORIGIN, instants(START_NS, duration_s, RATE_HZ), seed)


def mcity_street(
    make_node: Callable[[Node, float, float], PerceptionNode] = lee2021_node,
) -> tuple[Street, Instants]:
    """The second pass of `lee2021/mcity` and the instants (N,) of its fixes: the car, a second one
    2 s behind it, tunnel, and what hides a stretch of the road; the heads look South.

    The node's survey is the scenario's, 6 m above the ground.
    """
    survey, motion = lee2021.mcity_node(), lee2021_road.motion()
    begin_s, end_s = lee2021.cases()[MCITY_CASE].covered_s
    epochs = motion.every(lee2021_road.RATE_HZ // RATE_HZ)
    t_s = elapsed_s(epochs.t_ns, lee2021_road.START_NS)
    chosen = (t_s >= begin_s - MCITY_MARGIN_S) & (t_s <= end_s + MCITY_MARGIN_S)
    p_box_m = (epochs.p_world_m + epochs.R_world_veh @ np.array(lee2021.P_VEH_BOX_M))[:, :2]
    yaw_rad = np.unwrap(yaw_of(epochs.R_world_veh))
    later_ns = seconds_to_ns(FOLLOWING_S)
    movers = (
        Mover(CAR_ID, VEHICLE, epochs.t_ns, p_box_m, yaw_rad, colour=PALETTE[0]),
        Mover(FOLLOWER_ID, VEHICLE, epochs.t_ns + later_ns, p_box_m, yaw_rad, colour=PALETTE[2]),
    )
    node = make_node(survey, lee2021_road.NODE_HEIGHT_M, -np.pi / 2)
    fixed = Solids(*straight_solids(MCITY_SOLIDS, node.ground_m))
    return Street(node, fixed, movers), epochs.t_ns[chosen]


def make_mcity_street(seed: int = 0) -> Recording:
    """A recording of the second pass of `lee2021/mcity` at the instants of its fixes."""
    street, t_ns = mcity_street()
    return record(MCITY_NAME, street, lee2021_road.origin(), t_ns, seed)
