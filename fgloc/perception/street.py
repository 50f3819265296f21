"""A street of upright boxes beside a node: what stands, what moves, and how the node sways.

All that a simulated sensor sees (`ray_cast`, `street_images`) is the ground and these boxes. Boxes
are told in the node's surveyed axes; a node that sways sees them from elsewhere.
"""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from fgloc.arrays import Array, freeze
from fgloc.errors import InputError
from fgloc.frames import exp_so3
from fgloc.measurements import ObjectTruth
from fgloc.perception.boxes import upright_corners
from fgloc.perception.heads import PerceptionNode
from fgloc.timing import Instants, elapsed_s

CAR_SIZE_M = (4.6, 1.85, 1.5)
PERSON_SIZE_M = (0.5, 0.6, 1.75)


@dataclass(frozen=True, eq=False)
class Solids:
    """Upright boxes, by their centres (N, 3), sizes (N, 3) along length, width and height, yaws
    (N,) and colours (N, 3) of blue, green, red from 0 to 255."""

    centre_m: Array
    size_m: Array
    yaw_rad: Array
    colour: Array

    def __post_init__(self) -> None:
        for name, shape in {
            "centre_m": (3,),
            "size_m": (3,),
            "yaw_rad": (),
            "colour": (3,),
        }.items():
            array = freeze(getattr(self, name))
            if array.shape != (len(self.yaw_rad), *shape) or not np.isfinite(array).all():
                raise InputError(f"solids.{name}: expected finite numbers of shape {('N', *shape)}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.yaw_rad)

    @classmethod
    def none(cls) -> Self:
        """No boxes."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))

    def and_also(self, other: Self) -> Self:
        """These boxes, then the others."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return type(self)(*(np.concatenate(pair) for pair in pairs))

    def corners_m(self) -> Array:
        """(N, 8, 3) corners, as `upright_corners` has them."""
        return upright_corners(self.centre_m, self.size_m, self.yaw_rad)

    def moved(self, R: Array, p_m: ArrayLike) -> "Turned":
        """Centres (N, 3) and axes (N, 3, 3) in axes that are at p (3,), turned by R (3, 3)."""
        own = exp_so3(np.column_stack([np.zeros((len(self), 2)), self.yaw_rad]))
        return Turned((self.centre_m - np.asarray(p_m, float)) @ R, R.T @ own, self.size_m / 2)


@dataclass(frozen=True, eq=False)
class Turned:
    """Boxes in a sensor's axes: centres (N, 3), axes as columns (N, 3, 3), half sizes (N, 3)."""

    centre_m: Array
    axes: Array
    half_m: Array


@dataclass(frozen=True, eq=False)
class Mover:
    """A road user while it is there: its box on the ground at T instants, lines between them.

    Raises InputError where shapes do not fit, instants do not rise or a size is not above 0.

    t_ns       (T,) T from 2; before the first and after the last it is not there
    p_world_m  (T, 2) centre of its box, East and North
    yaw_rad    (T,) of its length, counter-clockwise from East, without jumps of a full turn
    size_m     (3,) length, width, height
    colour     (3,) blue, green, red
    """

    object_id: int
    kind: int
    t_ns: Instants
    p_world_m: Array
    yaw_rad: Array
    size_m: tuple[float, float, float] = CAR_SIZE_M
    colour: tuple[float, float, float] = (60.0, 60.0, 200.0)

    def __post_init__(self) -> None:
        n = len(self.t_ns)
        if n < 2 or self.p_world_m.shape != (n, 2) or self.yaw_rad.shape != (n,):
            raise InputError(f"mover {self.object_id}: expected 2 or more instants of (N, 2), (N,)")
        if (np.diff(self.t_ns) <= 0).any() or min(self.size_m) <= 0:
            raise InputError(f"mover {self.object_id}: instants must rise, sizes be above 0")

    def there(self, t_ns: int) -> bool:
        """Whether it is on the street."""
        return bool(self.t_ns[0] <= t_ns <= self.t_ns[-1])

    def state(self, t_ns: Instants) -> Array:
        """(N, 5) East, North, yaw, and velocity East and North at instants (N,)."""
        start_ns = int(self.t_ns[0])
        at, knots = elapsed_s(t_ns, start_ns), elapsed_s(self.t_ns, start_ns)
        rows = np.column_stack([self.p_world_m, self.yaw_rad])
        state = np.column_stack([np.interp(at, knots, column) for column in rows.T])
        piece = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
        return np.hstack([state, (np.diff(self.p_world_m.T) / np.diff(knots)).T[piece]])


@dataclass(frozen=True, eq=False)
class Sway:
    """How the node is off its survey at T instants, lines between them.

    t_ns      (T,) rising
    p_node_m  (T, 3) displacement along the surveyed axes
    turn_rad  (T, 3) small rotation vector along the same
    """

    t_ns: Instants
    p_node_m: Array
    turn_rad: Array

    def pose(self, t_ns: int) -> tuple[Array, Array]:
        """R (3, 3) and p (3,): x_surveyed = R x_now + p."""
        start_ns = int(self.t_ns[0])
        at, knots = elapsed_s(np.array([t_ns]), start_ns), elapsed_s(self.t_ns, start_ns)
        rows = np.hstack([self.turn_rad, self.p_node_m])
        values = np.array([np.interp(at, knots, column)[0] for column in rows.T])
        return exp_so3(values[:3]), values[3:]


@dataclass(frozen=True, eq=False)
class Street:
    """A node and all that it can see; `fixed` in the node's surveyed axes."""

    node: PerceptionNode
    fixed: Solids = field(default_factory=Solids.none)
    movers: tuple[Mover, ...] = ()
    sway: Sway | None = None

    def pose(self, t_ns: int) -> tuple[Array, Array]:
        """R (3, 3) and p (3,) of the node's axes at an instant, in the surveyed ones."""
        return (np.eye(3), np.zeros(3)) if self.sway is None else self.sway.pose(t_ns)

    def there(self, t_ns: int) -> list[Mover]:
        """The movers that are on the street at an instant."""
        return [mover for mover in self.movers if mover.there(t_ns)]

    def solids(self, t_ns: int) -> Solids:
        """All boxes at an instant in the node's surveyed axes: the fixed ones, then the movers."""
        movers = self.there(t_ns)
        if not movers:
            return self.fixed
        states = np.array([mover.state(np.array([t_ns]))[0] for mover in movers])
        sizes = np.array([mover.size_m for mover in movers])
        plan_m = self.node.node.from_world(states[:, :2])
        centre_m = np.column_stack([plan_m, self.node.ground_m + sizes[:, 2] / 2])
        yaw_rad = states[:, 2] - self.node.node.yaw_rad
        colours = np.array([mover.colour for mover in movers])
        return self.fixed.and_also(Solids(centre_m, sizes, yaw_rad, colours))

    def truth(self, t_ns: Instants) -> ObjectTruth:
        """Where the movers are at rising instants (N,), a row for each that is there then."""
        rows: list[tuple[int, int]] = [
            (k, m) for k, t in enumerate(t_ns.tolist())
            for m, mover in enumerate(self.movers) if mover.there(t)
        ]  # fmt: skip
        frame, number = np.array(rows, np.int64).reshape(-1, 2).T
        states = [mover.state(t_ns) for mover in self.movers]
        all_of = np.array(states).reshape(len(states), len(t_ns), 5)[number, frame]
        ids = np.array([mover.object_id for mover in self.movers], np.int64)[number]
        return ObjectTruth(t_ns[frame], t_ns[frame], ids, all_of[:, :2], all_of[:, 3:])
