"""Motion along a road: a chain of phases of speed and turning, over hills or on the level.

The motion is a closed formula of time but for the horizontal position, which is integrated to far
below a millimetre, so what simulated sensors say fits the truth exactly.

Speed is a chain of phases, each going from one speed to another along a smooth step; a phase may
also turn the heading along another smooth step of the distance it covers. A smooth step has two
continuous derivatives, so acceleration, turn rate and their first derivatives are continuous.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgloc import frames
from fgloc.datasets.simulator import Motion
from fgloc.measurements import Array
from fgloc.timing import NS_PER_S, Instants, elapsed_s

STEEPEST = 1.875
"""Largest slope of the smooth step, so the peak of what it ramps over what it does on average."""

LEVEL = np.zeros((0, 3))
"""No hills."""


@dataclass(frozen=True)
class Phase:
    """From one speed to another over a time, turning the heading by an angle meanwhile."""

    duration_s: float
    from_mps: float
    to_mps: float
    turn_rad: float = 0.0

    @property
    def length_m(self) -> float:
        return self.duration_s * (self.from_mps + self.to_mps) / 2


def road_motion(
    t_ns: Instants, phases: Sequence[Phase], heading_rad: float, hills: Array = LEVEL
) -> Motion:
    """The vehicle frame at even instants (N,), from the point (0, 0, 0) at the first of them.

    heading_rad  yaw at the start
    hills        (K, 3): greatest slope, wavelength in m and phase in rad of each wave of height
                 over the distance
    """
    s, v, a, yaw, yaw_rate, yaw_acc = _along_road(
        phases, heading_rad, elapsed_s(t_ns, int(t_ns[0]))
    )
    z, slope, bend, bend_rate = _hills(s, hills)

    direction = np.stack([np.cos(yaw), np.sin(yaw), slope], -1)
    d_direction = np.stack([-np.sin(yaw) * yaw_rate, np.cos(yaw) * yaw_rate, bend * v], -1)
    velocity = v[:, None] * direction
    acceleration = a[:, None] * direction + v[:, None] * d_direction
    position = _integrate(velocity, acceleration, float(t_ns[1] - t_ns[0]) / NS_PER_S)
    position[:, 2] = z - z[0]  # known in closed form

    # Nose up by the slope of the street, and its rates; the attitude is Rz(yaw) Ry(-pitch).
    pitch, flat = np.arctan(slope), 1 + slope**2
    pitch_rate = bend * v / flat
    pitch_acc = (bend_rate * v**2 + bend * a) / flat - 2 * slope * pitch_rate**2
    R_world_veh = frames.yaw_matrix(yaw) @ frames.exp_so3(np.outer(pitch, [0.0, -1.0, 0.0]))
    sin, cos = np.sin(pitch), np.cos(pitch)
    w = np.stack([yaw_rate * sin, -pitch_rate, yaw_rate * cos], -1)
    wdot = np.stack(
        [
            yaw_acc * sin + yaw_rate * pitch_rate * cos,
            -pitch_acc,
            yaw_acc * cos - yaw_rate * pitch_rate * sin,
        ],
        axis=-1,
    )
    return Motion(t_ns, position, velocity, acceleration, R_world_veh, w, wdot)


def _along_road(phases: Sequence[Phase], heading_rad: float, t_s: Array) -> tuple[Array, ...]:
    """At times (N,): distance on the map in m, its two derivatives, yaw in rad, its two."""
    T = np.array([phase.duration_s for phase in phases])
    v0 = np.array([phase.from_mps for phase in phases])
    dv = np.array([phase.to_mps for phase in phases]) - v0
    L = np.array([phase.length_m for phase in phases])
    turn = np.array([phase.turn_rad for phase in phases])
    begin_s, begin_m, begin_rad = (np.cumsum(x) - x for x in (T, L, turn))
    i = np.clip(np.searchsorted(begin_s, t_s, side="right") - 1, 0, len(phases) - 1)

    x = (t_s - begin_s[i]) / T[i]
    area, step, d_step, _ = _smooth_step(x)
    along = T[i] * (v0[i] * x + dv[i] * area)
    v, a = v0[i] + dv[i] * step, dv[i] * d_step / T[i]

    length = np.where(L > 0, L, 1.0)[i]  # a wait covers no distance and turns nothing
    _, turned, curve, d_curve = _smooth_step(along / length)
    yaw_per_m, yaw_per_m2 = turn[i] * curve / length, turn[i] * d_curve / length**2
    yaw = heading_rad + begin_rad[i] + turn[i] * turned
    return begin_m[i] + along, v, a, yaw, yaw_per_m * v, yaw_per_m2 * v**2 + yaw_per_m * a


def _smooth_step(x: Array) -> tuple[Array, Array, Array, Array]:
    """10x^3 - 15x^4 + 6x^5 on [0, 1]: its integral, itself and its first two derivatives."""
    x2 = x * x
    return (
        x2 * x2 * (2.5 - 3 * x + x2),
        x2 * x * (10 - 15 * x + 6 * x2),
        30 * x2 * (1 - x) ** 2,
        60 * x * (1 - x) * (1 - 2 * x),
    )


def _hills(s: Array, hills: Array) -> tuple[Array, Array, Array, Array]:
    """Height in m over the distance on the map, and its first three derivatives by it."""
    slope, wavelength_m, phase_rad = hills.T
    k = 2 * np.pi / wavelength_m
    angle = s[:, None] * k + phase_rad
    sin, cos = np.sin(angle), np.cos(angle)
    return sin @ (slope / k), cos @ slope, -sin @ (slope * k), -cos @ (slope * k**2)


def _integrate(velocity: Array, acceleration: Array, dt_s: float) -> Array:
    """Positions (N, 3) from 0: the trapezoid with its end correction, exact to fourth order."""
    mean = (velocity[1:] + velocity[:-1]) / 2
    correction = (acceleration[:-1] - acceleration[1:]) * dt_s / 12
    position = np.zeros_like(velocity)
    np.cumsum((mean + correction) * dt_s, axis=0, out=position[1:])
    return position
