"""What nodes send to cars, as bytes, and the network that brings it late or not at all.

Khamooshi (2023), section 4.4: m = {u, U, R}.
Differs from the paper: {u, U, x_bar}, since the consensus term needs the neighbour's prediction
and nothing needs R once U is there.
"""

import heapq
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError
from fgloc.measurements import Array

_MAGIC = b"ISN1"
_HEAD = struct.Struct("<4sHHq")
_EACH = np.dtype([("name", "<i8"), ("u", "<f8", 4), ("U", "<f8", (4, 4)), ("x", "<f8", 4)])


@dataclass(frozen=True, eq=False)
class Packet:
    """One node's information at one instant. Eq. (4.10).

    name   (n,) of the objects
    u, U   (n, 4) and (n, 4, 4) information vector and matrix of each object
    x_bar  (n, 4) what the node had predicted: East, North, and their velocities
    """

    node: int
    t_ns: int
    name: NDArray[np.int64]
    u: Array
    U: Array
    x_bar: Array

    def encode(self) -> bytes:
        """Little-endian bytes: a head of 16, then 200 for each object."""
        body = np.zeros(len(self.name), _EACH)
        body["name"], body["u"], body["U"], body["x"] = self.name, self.u, self.U, self.x_bar
        return _HEAD.pack(_MAGIC, self.node, len(self.name), self.t_ns) + body.tobytes()

    @classmethod
    def decode(cls, data: bytes) -> "Packet":
        """The packet in the bytes; InputError where they are none, or are cut short."""
        if len(data) < _HEAD.size or data[:4] != _MAGIC:
            raise InputError(
                f"{len(data)} bytes are no packet of a node: it begins with {_MAGIC!r}"
            )
        _, node, count, t_ns = _HEAD.unpack_from(data)
        if len(data) != _HEAD.size + count * _EACH.itemsize:
            raise InputError(
                f"a packet of {count} objects has {_HEAD.size + count * _EACH.itemsize} bytes, "
                f"not {len(data)}"
            )
        body = np.frombuffer(data, _EACH, count, _HEAD.size)
        return cls(node, t_ns, body["name"], body["u"], body["U"], body["x"])


class Network:
    """Bytes on their way: they come in the order of their arrival."""

    def __init__(self) -> None:
        self._queue: list[tuple[int, int, bytes]] = []
        self.sent = 0

    def send(self, data: bytes, received_ns: int) -> None:
        """Something that will arrive at an instant."""
        heapq.heappush(self._queue, (received_ns, self.sent, data))
        self.sent += 1

    def receive(self, until_ns: int) -> list[bytes]:
        """All that has arrived by an instant and was not taken before."""
        arrived = []
        while self._queue and self._queue[0][0] <= until_ns:
            arrived.append(heapq.heappop(self._queue)[2])
        return arrived
