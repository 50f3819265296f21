"""Where a camera is to a square code by its four corners: both poses that a square allows.

Seen in perspective, a flat square has two poses that explain its corners nearly as well as each
other, mirrored about the ray; far away only noise decides. Both are given, with how well they fit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fgloc.errors import InputError
from fgloc.measurements import Array


@dataclass(frozen=True, eq=False)
class SquarePoses:
    """The two poses, the better one first.

    R_cam_code    (2, 3, 3) from the code's axes (right, up, out of its face) to the camera's
                  (right, down, ahead)
    p_cam_code_m  (2, 3) the code's middle in the camera's axes, m
    error_px      (2,) rms of the corners
    """

    R_cam_code: Array
    p_cam_code_m: Array
    error_px: Array

    @property
    def range_m(self) -> Array:
        """(2,) from the camera to the code's middle; both poses nearly agree on it."""
        return np.linalg.norm(self.p_cam_code_m, axis=-1)

    @property
    def p_code_cam_m(self) -> Array:
        """(2, 3) the camera in the code's axes."""
        return -np.einsum("kji,kj->ki", self.R_cam_code, self.p_cam_code_m)

    def is_ambiguous(self, ratio: float = 2.0) -> bool:
        """Whether the second pose fits less than `ratio` times worse than the first."""
        return bool(self.error_px[1] < ratio * self.error_px[0])


def square_poses(
    corners_px: ArrayLike, size_m: float, focal_px: float, principal_px: ArrayLike
) -> SquarePoses:
    """Both poses of a square of `size_m` with corners (4, 2), clockwise from the upper left.

    The first pose is OpenCV's least-squares fit; the second starts from its mirror image about the
    ray and is fitted likewise. (Its closed form for squares is not used: in OpenCV 5.0.0 it
    returns wrong turns.) Raises InputError where the corners are no square's.
    """
    import cv2

    half, principal = size_m / 2, np.asarray(principal_px, float)
    square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    K = np.array([[focal_px, 0, principal[0]], [0, focal_px, principal[1]], [0, 0, 1]])
    corners = np.asarray(corners_px, float)
    fault = f"corners {corners.tolist()} px: no pose of a square fits them"
    try:
        _, turn, place = cv2.solvePnP(square, corners, K, None, flags=cv2.SOLVEPNP_ITERATIVE)
        one = cv2.Rodrigues(turn)[0], place.ravel()
        turn, place = cv2.solvePnPRefineLM(
            square, corners, K, None, cv2.Rodrigues(_mirrored(*one))[0], place.copy()
        )
    except cv2.error as err:
        raise InputError(fault) from err
    R, p = (np.stack(pair) for pair in zip(one, (cv2.Rodrigues(turn)[0], place.ravel()),
                                           strict=True))  # fmt: skip
    seen = np.einsum("kij,nj->kni", R, square) + p[:, None]
    if not np.isfinite(seen).all() or (seen[..., 2] <= 0).any():
        raise InputError(fault)
    off_px = focal_px * seen[..., :2] / seen[..., 2:] + principal - corners
    error_px = np.sqrt((off_px**2).sum(-1).mean(-1))
    order = np.argsort(error_px)
    return SquarePoses(R[order], p[order], error_px[order])


def _mirrored(R_cam_code: Array, p_cam_code_m: Array) -> Array:
    """(3, 3) the turn whose normal is mirrored about the ray: half a turn about the ray, and half
    a turn back in the code's plane."""
    ray = p_cam_code_m / np.linalg.norm(p_cam_code_m)
    about_ray = 2 * np.outer(ray, ray) - np.eye(3)
    return about_ray @ R_cam_code @ np.diag([-1.0, -1.0, 1.0])
