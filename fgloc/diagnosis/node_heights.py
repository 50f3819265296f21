"""Check of the heights that nodes tell, against those of the fixes."""

from collections.abc import Iterator

import numpy as np

from fgloc.diagnosis.finding import Finding, fault
from fgloc.diagnosis.gnss import sound_fixes
from fgloc.drive import Drive
from fgloc.infrastructure import Node
from fgloc.measurements import Array, GnssFixes, NodeDetections
from fgloc.timing import elapsed_s

NEAR_M, NEAR_S = 5.0, 1.0
"""What a node sees so near to the fixes in the plane, and in time, is mostly the car."""
FEWEST = 20
LEAST_M = 1.0
"""The car's pitch, the crown of the road and the sway of a post do not add up to more."""
SIGMAS = 4.0


def check_node_heights(drive: Drive) -> Iterator[Finding]:
    """A node whose heights lie apart from the car's: every detection would be gated."""
    seen, gnss = drive.tables.get(NodeDetections.KIND), sound_fixes(drive)
    if not isinstance(seen, NodeDetections) or gnss is None or len(gnss) < 2:
        return
    seen = seen.take(seen.has_height & np.isfinite(seen.p_node_m).all(-1))
    slow_m = drive.rig.gnss_bias.sigma_m if drive.rig.gnss_bias else 0.0
    fix_m = float(np.sqrt(np.median(gnss.cov_world_m2[:, 2, 2])))
    for i, node in enumerate(drive.infrastructure.nodes):
        apart_m = _apart_m(drive, node, seen.take(seen.node == i), gnss)
        if len(apart_m) < FEWEST:
            continue
        off_m = float(np.median(apart_m))
        doubt_m = float(np.linalg.norm([fix_m, slow_m, node.sigma_position_m]))
        if abs(off_m) > max(LEAST_M, SIGMAS * doubt_m):
            yield fault(
                "node-height",
                "detections",
                f"node {node.name!r} tells heights that lie {off_m:+.1f} m from those of the fixes "
                f"(median of {len(apart_m):,} detections near them)",
                "is the node's p_world_m[2] in the height datum of [origin], and is "
                "rig.p_veh_box_m[2] the height of the point that it tells?",
            )


def _apart_m(drive: Drive, node: Node, seen: NodeDetections, gnss: GnssFixes) -> Array:
    """Heights (M,) that a node tells of what is near the fixes, less those of the box by these."""
    t_s = elapsed_s(seen.t_ns, int(gnss.t_ns[0]))
    have_s = elapsed_s(gnss.t_ns, int(gnss.t_ns[0]))
    at_m = np.column_stack([np.interp(t_s, have_s, column) for column in gnss.p_world_ant_m.T])
    after = np.clip(np.searchsorted(have_s, t_s), 1, len(have_s) - 1)
    away_s = np.minimum(np.abs(t_s - have_s[after - 1]), np.abs(have_s[after] - t_s))
    apart_m = node.place_to_world(seen.place_node_m) - at_m
    near = (np.hypot(*apart_m[:, :2].T) < NEAR_M) & (away_s < NEAR_S)
    box_over_antenna_m = drive.rig.p_veh_box_m[2] - drive.rig.p_veh_ant_m[2]
    return np.asarray(apart_m[near, 2] - box_over_antenna_m)
