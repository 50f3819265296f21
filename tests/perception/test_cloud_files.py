"""Files of points and images: what is read, and what a damaged or foreign one is told."""

import sys
import types
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fgloc.errors import DriveError, InputError
from fgloc.perception.image_files import read_image, write_image
from fgloc.perception.point_clouds import import_open3d, read_cloud, write_cloud

POINTS = np.array([[1.0, 2, 3], [-4.5, 0.25, 6], [7, 8, -9]])
ROWS = "\n".join(" ".join(map(str, row)) for row in POINTS.tolist())
PCD = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\n"
    f"POINTS 3\nDATA ascii\n{ROWS}\n"
)
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    f"property float z\nend_header\n{ROWS}\n"
)


@pytest.mark.parametrize(("name", "text"), [("a.pcd", PCD), ("a.ply", PLY), ("A.PLY", PLY)])
def test_pcd_and_ply_are_read(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    np.testing.assert_array_equal(read_cloud(tmp_path / name), POINTS)


def test_npz_is_read_as_written_and_needs_no_open3d(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    write_cloud(tmp_path / "a.npz", POINTS)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npz"), POINTS)
    np.savez(tmp_path / "b.npz", cloud=np.column_stack([POINTS, [1, 2, 3]]))
    np.testing.assert_array_equal(read_cloud(tmp_path / "b.npz"), POINTS)


def test_empty_clouds_are_clouds(tmp_path):
    write_cloud(tmp_path / "a.npz", np.empty((0, 3)))
    (tmp_path / "a.pcd").write_text(PCD.replace(" 3\n", " 0\n").replace(ROWS, ""))
    (tmp_path / "a.ply").write_text(PLY.replace("vertex 3", "vertex 0").replace(ROWS, ""))
    for name in ("a.npz", "a.pcd", "a.ply"):
        assert read_cloud(tmp_path / name).shape == (0, 3)


@pytest.mark.parametrize(("name", "raw", "message"), [
    ("a.pcd", b"junk", "finds no points in it; is it damaged"),
    ("a.ply", PLY[:40].encode(), "finds no points in it"),
    ("a.npz", b"PK\x03\x04 and no more", "is no NPZ file or is damaged"),
    ("a.npz", b"", "is no NPZ file or is damaged"),
    ("a.las", b"", "a cloud is one of .npz, .pcd, .ply; convert it"),
])  # fmt: skip
def test_a_damaged_cloud_is_told_with_its_file(tmp_path, name, raw, message):
    path = tmp_path / name
    path.write_bytes(raw)
    with pytest.raises(DriveError, match=f"{name}: .*{message}"):
        read_cloud(path)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=80)
@given(changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=4))
def test_wherever_an_npz_is_damaged_it_is_told_or_read_whole(tmp_path, changes):
    path = tmp_path / "a.npz"
    write_cloud(path, np.arange(150).reshape(50, 3))
    raw = bytearray(path.read_bytes())
    for share, value in changes:
        raw[int(share * (len(raw) - 1))] = value
    path.write_bytes(raw)
    try:
        assert read_cloud(path).shape[1:] == (3,)
    except DriveError as err:
        assert str(path) in str(err)


def test_an_npz_of_other_things_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, x=np.zeros(3), y=np.zeros(3))
    with pytest.raises(DriveError, match="holds the arrays x, y; name the one of the points"):
        read_cloud(path)
    np.savez(path, points=np.zeros((3, 2)))
    with pytest.raises(DriveError, match=r"shape \(3, 2\) and type float64: expected numbers"):
        read_cloud(path)
    with pytest.raises(DriveError, match="no such file"):
        read_cloud(tmp_path / "none.npz")


def test_open3d_brings_its_own_libusb():
    if not Path("/proc/self/maps").exists():
        pytest.skip("tells by /proc which libraries are loaded")
    import_open3d()
    maps = Path("/proc/self/maps").read_text().splitlines()
    assert {Path(line.split()[-1]).parent.name for line in maps if "libusb" in line} == {
        "libusb_package"
    }


def test_a_missing_system_library_is_told_with_its_remedy(monkeypatch):
    def refuse():
        raise OSError("libGL.so.1: cannot open shared object file")

    package = types.SimpleNamespace(get_library_path=refuse)
    monkeypatch.setitem(sys.modules, "libusb_package", package)
    with pytest.raises(InputError, match=r"libGL.so.1: .*apt-get install libusb-1.0-0 libgl1"):
        import_open3d()


def picture() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)


def test_png_is_read_as_written_and_jpeg_nearly(tmp_path):
    write_image(tmp_path / "a.png", picture())
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), picture())
    even = np.full((40, 60, 3), 90, np.uint8)
    write_image(tmp_path / "a.jpg", even)
    np.testing.assert_allclose(read_image(tmp_path / "a.jpg"), even, atol=2)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_half_an_image_is_no_image(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_image(path, picture())
    path.write_bytes(path.read_bytes()[:-1100])
    with pytest.raises(DriveError, match=r"the image is cut off after \d+ bytes"):
        read_image(path)


def test_a_png_with_a_wrong_byte_is_no_image(tmp_path):
    path = tmp_path / "a.png"
    write_image(path, picture())
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 0xFF
    path.write_bytes(raw)
    with pytest.raises(DriveError, match="the image is damaged"):
        read_image(path)


def test_what_is_no_image_is_told_with_its_file(tmp_path):
    (tmp_path / "a.png").write_bytes(b"GIF89a")
    with pytest.raises(DriveError, match=r"a\.png: is neither PNG nor JPEG inside"):
        read_image(tmp_path / "a.png")
    (tmp_path / "b.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50) + b"IEND")
    with pytest.raises(DriveError, match=r"b\.png: the image is damaged"):
        read_image(tmp_path / "b.png")
    with pytest.raises(DriveError, match=r"c\.png: no such file"):
        read_image(tmp_path / "c.png")
    with pytest.raises(DriveError, match=r"an image is one of \.png, \.jpg, \.jpeg"):
        read_image(tmp_path / "d.tiff")
