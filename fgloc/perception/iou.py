"""How much boxes overlap, in the image and in space, and the best pairs of two sets.

Intersection over union (IoU) of upright cuboids is exact: their plans are convex polygons, their
heights are intervals. Pairs are those of the greatest sum (the Hungarian method) among those that
may be pairs at all.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.measurements import Array

Pairs = NDArray[np.int64]
"""(K, 2) rows of the first and of the second set."""
_UNIT = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def image_iou(first_px: ArrayLike, second_px: ArrayLike) -> Array:
    """IoU (N, M) of boxes (N, 4) and (M, 4): left, upper, right, lower edge; NaN overlaps none."""
    a, b = (np.asarray(boxes, float).reshape(-1, 4) for boxes in (first_px, second_px))
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    shared = np.clip(high - low, 0, None).prod(-1)
    size_a, size_b = ((box[:, 2:] - box[:, :2]).prod(-1) for box in (a, b))
    return np.nan_to_num(shared / (size_a[:, None] + size_b - shared))


def cuboid_iou(
    first: tuple[ArrayLike, ArrayLike, ArrayLike], second: tuple[ArrayLike, ArrayLike, ArrayLike]
) -> Array:
    """IoU (N, M) of upright cuboids, each set given as centres (N, 3) in m, lengths, widths and
    heights (N, 3) in m, and yaws (N,) of the lengths."""
    (centre_a, size_a, yaw_a), (centre_b, size_b, yaw_b) = _arrays(first), _arrays(second)
    low, high = (
        choose(centre_a[:, None, 2] + sign * size_a[:, None, 2] / 2,
               centre_b[None, :, 2] + sign * size_b[None, :, 2] / 2)
        for sign, choose in ((-1, np.maximum), (1, np.minimum))
    )  # fmt: skip
    tall = np.clip(high - low, 0, None)
    reach = np.hypot(*size_a[:, :2].T)[:, None] + np.hypot(*size_b[:, :2].T)
    apart = np.linalg.norm(centre_a[:, None, :2] - centre_b[None, :, :2], axis=-1)
    plan = np.zeros_like(tall)
    corners_a, corners_b = _plan(centre_a, size_a, yaw_a), _plan(centre_b, size_b, yaw_b)
    for i, j in np.argwhere((tall > 0) & (2 * apart < reach)).tolist():
        plan[i, j] = _shared(corners_a[i], corners_b[j])
    shared = plan * tall
    union = size_a.prod(-1)[:, None] + size_b.prod(-1) - shared
    return np.asarray(shared / union)


def best_pairs(worth: Array, allowed: NDArray[np.bool_]) -> Pairs:
    """The pairs (K, 2) of rows and columns of `worth` (N, M) that are worth most together.

    Where a pair is not allowed (N, M) it is not made; a pair that is allowed is always better than
    none, so as many as possible are made.
    """
    from scipy.optimize import linear_sum_assignment

    if not allowed.any():
        return np.empty((0, 2), np.int64)
    span = float(np.ptp(worth[allowed])) + 1.0
    reward = np.where(allowed, worth - worth[allowed].min() + span * min(worth.shape), 0.0)
    row, column = linear_sum_assignment(reward, maximize=True)
    fits = allowed[row, column]
    return np.column_stack([row[fits], column[fits]])


def _arrays(cuboids: tuple[ArrayLike, ArrayLike, ArrayLike]) -> tuple[Array, Array, Array]:
    centre, size, yaw = (np.asarray(column, float) for column in cuboids)
    return centre.reshape(-1, 3), size.reshape(-1, 3), yaw.reshape(-1)


def _plan(centre: Array, size: Array, yaw: Array) -> Array:
    """(N, 4, 2) corners of the plans, counter-clockwise."""
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s], [s, c]]).transpose(2, 0, 1)
    return np.asarray((_UNIT * size[:, None, :2]) @ R.swapaxes(1, 2) + centre[:, None, :2])


def _shared(a: Array, b: Array) -> float:
    """Area of what two convex polygons (4, 2) share, both counter-clockwise.

    The first is cut along each edge of the second (Sutherland and Hodgman 1974). OpenCV does it in
    single precision, and gives the larger for the smaller where edges all but meet.
    """
    origin = a.mean(0)
    left, corners = (a - origin).tolist(), (b - origin).tolist()
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        inside = [(x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) for x, y in left]
        kept = []
        for k, (x, y) in enumerate(left):
            before, now = inside[k - 1], inside[k]
            if (before < 0) != (now < 0):
                share = before / (before - now)
                kept.append([p + share * (q - p) for p, q in zip(left[k - 1], (x, y), strict=True)])
            if now >= 0:
                kept.append([x, y])
        left = kept
    edges = zip(left, left[1:] + left[:1], strict=True)
    return max(sum(p[0] * q[1] - q[0] * p[1] for p, q in edges) / 2, 0.0)
