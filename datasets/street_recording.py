"""A recording of what the sensors of a simulated street's node see, frames made on demand.

Every frame draws from a stream of its own, so that it is the same whenever it is asked for.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.simulator import stream
from fgloc.drive import About
from fgloc.errors import InputError
from fgloc.frames import Origin
from fgloc.measurements import Array
from fgloc.perception.heads import Camera, Lidar
from fgloc.perception.ray_cast import scan
from fgloc.perception.recording import Frames, Image, Recording
from fgloc.perception.street import Street
from fgloc.perception.street_images import Painter
from fgloc.timing import Instants, seconds_to_ns

LATENCY_S = 0.1
PIXEL_NOISE = 3.0
"""Grey levels."""


def record(
    name: str, street: Street, origin: Origin, t_ns: Instants, seed: int,
    latency_s: float = LATENCY_S,
) -> Recording:  # fmt: skip
    """The recording of all sensors at the same rising instants (N,), with the movers' truth.

    latency_s  after which a frame arrives

    Raises InputError for a seed below 0 or a latency that is none.
    """
    if not 0 <= latency_s < np.inf:
        raise InputError(f"latency_s = {latency_s}: expected seconds, 0 or more")
    node = street.node
    received_ns = t_ns + seconds_to_ns(latency_s)

    def frames(sensor: str, load: Callable[[int], NDArray[np.generic]]) -> Frames:
        return Frames(sensor, t_ns, received_ns, load)

    images = tuple(
        frames(camera.name, partial(_image, _painter(street, camera, seed), camera, t_ns, seed))
        for camera in node.cameras
    )
    clouds = tuple(
        frames(head.lidar.name, partial(_cloud, street, head.lidar, t_ns, seed))
        if head.lidar else None
        for head in node.heads
    )  # fmt: skip
    about = About(title=f"Simulated street, seed {seed}", licence="MIT",
                  source=f"fgloc street {name}, seed {seed}", simulated=True)  # fmt: skip
    return Recording(name, origin, node, images, clouds, None, street.truth(t_ns), about)


def _painter(street: Street, camera: Camera, seed: int) -> Callable[[], Painter]:
    """Makes the painter when the first image is asked for, and once."""
    return cache(
        lambda: Painter.make(street, camera, stream(seed, f"image/{camera.name}"), PIXEL_NOISE)
    )


def _image(
    painter: Callable[[], Painter], camera: Camera, t_ns: Instants, seed: int, frame: int
) -> Image:
    return painter().paint(int(t_ns[frame]), stream(seed, f"image/{camera.name}/{frame}"))


def _cloud(street: Street, lidar: Lidar, t_ns: Instants, seed: int, frame: int) -> Array:
    return scan(street, lidar, int(t_ns[frame]), stream(seed, f"{lidar.name}/{frame}")).points_m


def straight_solids(
    rows: Sequence[tuple[float, float, float, float, float, float]],
    ground_m: float,
    grey: float = 150.0,
) -> tuple[Array, Array, Array, Array]:
    """Centres, sizes, yaws and colours of boxes along the node's axes, given by their first and
    last x, first and last y, and lowest and highest z above the ground (N, 6), m."""
    limits = np.array(rows, float).reshape(-1, 3, 2)
    centre_m = limits.mean(-1) + [0, 0, ground_m]
    size_m = limits[..., 1] - limits[..., 0]
    n = len(limits)
    shades = grey + 20.0 * (np.arange(n)[:, None] % 4) + np.array([10.0, 0.0, -20.0])
    return centre_m, size_m, np.zeros(n), shades
