"""A tiny network as the bytes of an ONNX file: a constant, and the mean of what it is shown times
another.

Protobuf's wire format by hand: a field is its number and type in one varint, then its value.
"""

import struct

import numpy as np

FLOAT, INT64 = 1, 7
IR_VERSION, OPSET = 8, 13


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def whole(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value)


def block(number: int, content: bytes | str) -> bytes:
    content = content.encode() if isinstance(content, str) else content
    return varint(number << 3 | 2) + varint(len(content)) + content


def tensor(name: str, array: np.ndarray) -> bytes:
    dims = b"".join(whole(1, n) for n in array.shape)
    return dims + whole(2, FLOAT) + block(8, name) + block(9, array.astype("<f4").tobytes())


def value_info(name: str, shape) -> bytes:
    dims = b"".join(block(1, whole(1, n)) for n in shape)
    return block(1, name) + block(2, block(1, whole(1, FLOAT) + block(2, dims)))


def node(kind: str, inputs, output: str, attributes: bytes = b"") -> bytes:
    return (
        b"".join(block(1, name) for name in inputs) + block(2, output) + block(3, output)
        + block(4, kind) + attributes
    )  # fmt: skip


def integers(name: str, values) -> bytes:
    return block(5, block(1, name) + b"".join(whole(8, v) for v in values) + whole(20, INT64))


def network(output: np.ndarray, gain: np.ndarray, width: int, height: int) -> bytes:
    """The file of a network with input (1, 3, height, width) that says output + gain * mean."""
    shape = (1, 3, height, width)
    keep = block(5, block(1, "keepdims") + whole(3, 1) + whole(20, 2))
    axes = integers("axes", range(4))
    one = (1,) * output.ndim
    graph = b"".join([
        block(1, node("ReduceMean", ["image"], "mean", axes + keep)),
        block(1, node("Reshape", ["mean", "shape"], "flat")),
        block(1, node("Mul", ["flat", "gain"], "more")),
        block(1, node("Add", ["more", "said"], "output")),
        block(2, "constant"),
        block(5, shape_tensor("shape", one)),
        block(5, tensor("gain", gain)),
        block(5, tensor("said", output)),
        block(11, value_info("image", shape)),
        block(12, value_info("output", output.shape)),
    ])  # fmt: skip
    opset = block(8, block(1, "") + whole(2, OPSET))
    return whole(1, IR_VERSION) + opset + block(7, graph)


def shape_tensor(name: str, values) -> bytes:
    raw = struct.pack(f"<{len(values)}q", *values)
    return whole(1, len(values)) + whole(2, INT64) + block(8, name) + block(9, raw)
