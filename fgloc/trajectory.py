"""A trajectory: where a point of the vehicle was, how it was turned, and how sure that is."""

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from fgloc import frames
from fgloc.arrays import Array, freeze, freeze_ns, sealed
from fgloc.errors import InputError
from fgloc.timing import NS_PER_S, Instants


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses over time, in the world frame (ENU); also the form that truth takes.

    t_ns            (N,) strictly increasing instants
    p_world_m       (N, 3) position in m of the point `p_veh_point_m` of the vehicle
    R_world_veh     (N, 3, 3) attitude, or None where only positions are known
    v_world_mps     (N, 3) velocity of that point in m/s, or None
    cov             (N, 6, 6) of position (m) and then of the small rotation vector (rad) that
                    turns the attitude from the world side, both in ENU; or None
    p_veh_point_m   (3,) the point, in the vehicle frame

    Raises InputError where shapes do not fit, stamps are not integers, a value is not finite or
    time does not increase.
    """

    t_ns: Instants
    p_world_m: Array
    R_world_veh: Array | None = None
    v_world_mps: Array | None = None
    cov: Array | None = None
    p_veh_point_m: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", freeze_ns("trajectory t_ns", self.t_ns))
        if self.t_ns.ndim != 1:
            raise InputError(f"trajectory t_ns has shape {self.t_ns.shape}, expected (N,)")
        n = len(self.t_ns)
        shapes: dict[str, tuple[int, ...]] = {
            "p_world_m": (n, 3), "R_world_veh": (n, 3, 3), "v_world_mps": (n, 3),
            "cov": (n, 6, 6), "p_veh_point_m": (3,),
        }  # fmt: skip
        stuck = np.flatnonzero(self.t_ns[1:] <= self.t_ns[:-1])  # a difference could overflow
        if len(stuck):
            row = int(stuck[0]) + 1
            raise InputError(f"trajectory row {row}: t_ns {self.t_ns[row]} does not increase")
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            value = freeze(value)
            if value.shape != shape:
                raise InputError(f"trajectory {name} has shape {value.shape}, expected {shape}")
            if not np.isfinite(value).all():
                row = int(np.argwhere(~np.isfinite(value))[0][0])
                raise InputError(f"trajectory {name} is not finite at row {row}")
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def yaw_rad(self) -> Array:
        """Yaw (N,) in rad, counter-clockwise from East; raises InputError without attitude."""
        return frames.yaw_of(self.attitude())

    def attitude(self) -> Array:
        """`R_world_veh`, or InputError where the trajectory has none."""
        if self.R_world_veh is None:
            raise InputError("this trajectory has positions only; an attitude is needed here")
        return self.R_world_veh

    def take(self, index: Any) -> Self:
        """The states that a slice, mask or index array selects."""
        names = ("t_ns", "p_world_m", "R_world_veh", "v_world_mps", "cov")
        there = [name for name in names if getattr(self, name) is not None]
        kept: Any = {name: sealed(getattr(self, name)[index]) for name in there}
        return replace(self, **kept)

    def at_point(self, p_veh_point_m: ArrayLike) -> Self:
        """The same motion told of another point of the vehicle, through the attitude.

        The covariance of position is carried through the lever arm; a velocity is dropped,
        since the angular rate is not known. Raises InputError where attitude is missing.
        """
        lever = np.asarray(p_veh_point_m, float) - self.p_veh_point_m
        if not lever.any():
            return self
        arm_world = (self.attitude().reshape(-1, 3) @ lever).reshape(-1, 3)
        cov = self.cov
        if cov is not None:
            W, cov = frames.skew(arm_world), cov.copy()  # J cov J' of J = [[I, -W], [0, I]]
            cov[:, :3] -= W @ cov[:, 3:]
            cov[:, :, :3] -= cov[:, :, 3:] @ W.swapaxes(-1, -2)
            cov = sealed(cov)
        return replace(
            self, p_world_m=sealed(self.p_world_m + arm_world), v_world_mps=None, cov=cov,
            p_veh_point_m=np.asarray(p_veh_point_m, float),
        )  # fmt: skip

    def covers(self, t_ns: ArrayLike, max_gap_s: float = np.inf) -> np.ndarray[Any, Any]:
        """(M,) bool: whether an instant lies on or between states no further apart than the gap."""
        t = np.asarray(t_ns, np.int64)
        if len(self) == 0:
            return np.zeros(t.shape, bool)
        left = np.clip(np.searchsorted(self.t_ns, t, side="right") - 1, 0, len(self) - 1)
        right = np.clip(np.searchsorted(self.t_ns, t, side="left"), 0, len(self) - 1)
        inside = (t >= self.t_ns[0]) & (t <= self.t_ns[-1])
        return inside & ((self.t_ns[right] - self.t_ns[left]) / NS_PER_S <= max_gap_s)

    def at(self, t_ns: ArrayLike) -> Self:
        """The trajectory at other instants (M,), which must lie within its span.

        Positions follow a cubic Hermite curve where velocities are known and a straight line
        otherwise; attitudes turn at a constant rate; covariances are mixed linearly, which never
        claims more than the two neighbours do. Raises InputError outside the span.
        """
        t = np.asarray(t_ns, np.int64)
        if len(t) == len(self) and np.array_equal(t, self.t_ns):
            return self
        if len(self) == 0 or len(t) == 0 or t.min() < self.t_ns[0] or t.max() > self.t_ns[-1]:
            raise InputError("cannot interpolate outside the trajectory's span of time")
        i = np.clip(np.searchsorted(self.t_ns, t, side="right") - 1, 0, max(len(self) - 2, 0))
        j = np.minimum(i + 1, len(self) - 1)
        dt_s = np.maximum((self.t_ns[j] - self.t_ns[i]) / 1e9, 1e-9)[:, None]
        s = (t - self.t_ns[i])[:, None] / 1e9 / dt_s
        p, v = _hermite(self.p_world_m, self.v_world_mps, i, j, s, dt_s)
        R = None
        if self.R_world_veh is not None:
            R_i, R_j = self.R_world_veh[i], self.R_world_veh[j]
            R = sealed(R_i @ frames.exp_so3(s * frames.log_so3(R_i.swapaxes(-1, -2) @ R_j)))
        cov = None
        if self.cov is not None:
            w = s[..., None]
            cov = sealed((1 - w) * self.cov[i] + w * self.cov[j])
        return replace(self, t_ns=t, p_world_m=p, R_world_veh=R, v_world_mps=v, cov=cov)

    def sigma_along_across_m(self) -> tuple[Array, Array]:
        """Standard deviations (N,) in m along and across the heading; InputError without them."""
        if self.cov is None:
            raise InputError("this trajectory has no covariance")
        yaw = self.yaw_rad
        along = np.stack([np.cos(yaw), np.sin(yaw)], -1)
        across = np.stack([-np.sin(yaw), np.cos(yaw)], -1)
        variance = self.cov[:, :2, :2]
        return (
            np.sqrt(np.einsum("ni,nij,nj->n", along, variance, along)),
            np.sqrt(np.einsum("ni,nij,nj->n", across, variance, across)),
        )

    def same_as(self, other: "Trajectory") -> bool:
        """Whether both are equal in every bit."""
        names = ("t_ns", "p_world_m", "R_world_veh", "v_world_mps", "cov", "p_veh_point_m")
        pairs = [(getattr(self, name), getattr(other, name)) for name in names]
        return all(
            (a is None and b is None) or (a is not None and b is not None and np.array_equal(a, b))
            for a, b in pairs
        )


def _hermite(
    p: Array, v: Array | None, i: Any, j: Any, s: Array, dt_s: Array
) -> tuple[Array, Array | None]:
    """Positions and velocities between knots i and j at the fraction s of the way."""
    if v is None:
        return (1 - s) * p[i] + s * p[j], None
    step = p[j] - p[i]
    position = (
        p[i]
        + s**2 * (3 - 2 * s) * step
        + s * (1 - s) ** 2 * dt_s * v[i]
        - s**2 * (1 - s) * dt_s * v[j]
    )
    velocity = 6 * s * (1 - s) * step / dt_s + (1 - s) * (1 - 3 * s) * v[i] + s * (3 * s - 2) * v[j]
    return position, velocity
