"""Codes read in rendered images: right or not at all, corners to parts of a pixel."""

import json

import numpy as np
import pytest

from fgloc.datasets.marr2019_smart_code import FOCAL_PX, LARGE_M
from fgloc.datasets.sign_records import read_sign_records, record_of
from fgloc.errors import DriveError, InputError
from fgloc.perception.smart_code_reader import MarkerReader, code_bits
from fgloc.perception.smart_code_renderer import DARK, MOST, Look, render, strobe_grey
from fgloc.perception.square_pose import square_poses

from .rendered import CODES, PRINCIPAL_PX, right_and_wrong, scene

SQUARE = np.array([[60.0, 50], [160, 50], [160, 150], [60, 150]])
PLAIN = Look(blur_px=0.0, noise=0.0, clutter=0)


@pytest.fixture(scope="module")
def reader() -> MarkerReader:
    return MarkerReader.smart_codes(CODES)


def drawn(code="22a1", corners=SQUARE, look=PLAIN, range_m=5.0, seed=0):
    rng = np.random.default_rng(seed)
    return render(code_bits(code), corners, range_m, (200, 220), look, rng)


def test_any_two_of_the_codebook_differ_in_18_cells_however_turned():
    bits = np.stack([code_bits(code) for code in CODES])
    plain = bits.reshape(len(bits), -1)
    for turn in range(4):
        turned = np.rot90(bits, turn, (1, 2)).reshape(len(bits), -1)
        differ = (plain[:, None] != turned[None]).sum(-1)
        if turn == 0:
            np.fill_diagonal(differ, 99)
        assert differ.min() >= 18


def test_a_plain_image_gives_text_and_corners_in_their_order():
    read = MarkerReader.smart_codes(["22a1", "05b2"]).read(drawn())
    assert read.codes == ("22a1",)
    np.testing.assert_allclose(read.corners_px[0], SQUARE, atol=0.6)


def test_the_first_corner_turns_with_the_code():
    turned = np.roll(SQUARE, 1, axis=0)
    read = MarkerReader.smart_codes(["22a1"]).read(drawn(corners=turned))
    np.testing.assert_allclose(read.corners_px[0], turned, atol=0.6)


def test_a_code_that_is_not_known_is_not_read_as_another(reader):
    assert reader.read(drawn("ffffff")).codes == ()


def test_an_image_of_clutter_alone_has_no_codes(reader):
    rng = np.random.default_rng(5)
    away = SQUARE + 1e4
    for _ in range(20):
        image = render(code_bits("22a1"), away, 5.0, (300, 300), Look(clutter=40), rng)
        assert reader.read(image).codes == ()


def test_large_codes_are_read_inside_15_m_and_never_wrongly(reader):
    rng, n = np.random.default_rng(0), 80
    scenes = [scene(rng, LARGE_M, rng.uniform(4, 15), Look(0.6, 4.0, 12)) for _ in range(n)]
    counts = np.array([right_and_wrong(reader.read(s.image), s.code) for s in scenes])
    assert counts[:, 1].sum() == 0
    assert np.mean(counts[:, 0] == 1) >= 0.95


def test_corners_give_the_range_to_half_a_percent(reader):
    rng = np.random.default_rng(1)
    for _ in range(15):
        s = scene(rng, LARGE_M, rng.uniform(5, 12), Look())
        read = reader.read(s.image)
        corners = read.corners_px[read.codes.index(s.code)] + s.offset_px
        assert np.abs(corners - s.corners_px).max() < 1.0
        poses = square_poses(corners, LARGE_M, FOCAL_PX, PRINCIPAL_PX)
        assert poses.range_m[0] == pytest.approx(s.range_m, rel=0.005)


def test_one_of_the_two_poses_of_a_square_is_the_true_one():
    turn = np.deg2rad(35)
    right, down = np.array([np.cos(turn), 0, -np.sin(turn)]), np.array([0.0, 1, 0])
    middle = np.array([1.0, -0.5, 9.0])
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.25
    corners = middle + sides[:, :1] * right + sides[:, 1:] * down
    px = FOCAL_PX * corners[:, :2] / corners[:, 2:] + PRINCIPAL_PX
    poses = square_poses(px, 0.5, FOCAL_PX, PRINCIPAL_PX)
    np.testing.assert_allclose(poses.p_cam_code_m[0], middle, atol=1e-5)
    np.testing.assert_allclose(poses.R_cam_code[0][:, 0], right, atol=1e-5)
    np.testing.assert_allclose(poses.R_cam_code[0] @ poses.p_code_cam_m[0], -middle, atol=1e-5)
    assert 10 * poses.error_px[0] < poses.error_px[1]
    assert not poses.is_ambiguous()


def test_a_far_square_seen_with_noise_may_stand_either_way():
    rng = np.random.default_rng(2)
    px = np.array([[1220.0, 1020], [1231, 1020], [1231, 1031], [1220, 1031]])
    poses = square_poses(px + 0.3 * rng.standard_normal((4, 2)), 0.127, FOCAL_PX, PRINCIPAL_PX)
    assert poses.is_ambiguous()
    assert poses.range_m[0] == pytest.approx(poses.range_m[1], rel=0.05)


def test_corners_on_one_point_are_no_square():
    with pytest.raises(InputError, match="no pose of a square"):
        square_poses(np.zeros((4, 2)), 0.5, FOCAL_PX, PRINCIPAL_PX)


def test_the_strobe_saturates_near_and_falls_with_the_square_of_the_distance():
    near, at, far = strobe_grey([3.0, 18.0, 36.0])
    assert near == at == MOST
    assert far - DARK == pytest.approx((MOST - DARK) / 4)


@pytest.mark.parametrize("code", ["", "22A1", "0x1", "22g1"])
def test_a_text_that_is_not_hexadecimal_has_no_code(code):
    with pytest.raises(InputError, match="expected hexadecimal"):
        code_bits(code)


def test_two_equal_codes_or_none_make_no_reader():
    with pytest.raises(InputError, match="'1' and '1' differ in 0 of 81 cells"):
        MarkerReader.smart_codes(["1", "1"])
    with pytest.raises(InputError, match="at least one code"):
        MarkerReader.smart_codes([])


@pytest.mark.parametrize("image", [np.zeros((5, 5, 3), np.uint8), np.zeros((5, 5))])
def test_what_is_no_grey_image_is_refused(image):
    with pytest.raises(InputError, match="give grey as uint8"):
        MarkerReader.april_tags().read(image)


RECORD = {"name": "curve", "p_world_m": [0.0, 1.0, 2.1], "normal_yaw_rad": -1.5, "size_m": 0.5588,
          "side": "left", "message": "curve in 100 m"}  # fmt: skip


def test_a_code_leads_to_its_record_and_sign(tmp_path):
    path = tmp_path / "signs.json"
    path.write_text(json.dumps({"22a1": RECORD}))
    record = record_of("22a1", read_sign_records(path))
    assert record.message == "curve in 100 m"
    sign = record.sign("22a1")
    assert (sign.name, sign.code, sign.side, sign.size_m) == ("curve", "22a1", "left", 0.5588)
    np.testing.assert_array_equal(sign.p_world_m, [0, 1, 2.1])


def test_an_unknown_code_is_refused_by_name(tmp_path):
    path = tmp_path / "signs.json"
    path.write_text(json.dumps({"22a1": RECORD}))
    with pytest.raises(InputError, match="Smart Code '22a7' has no sign record; the nearest is '2"):
        record_of("22a7", read_sign_records(path))
    with pytest.raises(InputError, match="'1': there are no sign records"):
        record_of("1", {})


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "signs.json: not valid JSON"),
        ("[]", "expected an object that maps codes"),
        ('{"1": 5, "1": 6}', "'1' occurs twice"),
        (json.dumps({"0X1": RECORD}), "code = '0X1': expected hexadecimal"),
        (json.dumps({"1": RECORD | {"size_m": -1.0}}), "size_m"),
        (json.dumps({"1": RECORD | {"colour": "red"}}), "colour"),
        ("", "is empty"),
    ],
)
def test_faulty_records_are_refused(tmp_path, text, says):
    (tmp_path / "signs.json").write_text(text)
    with pytest.raises(DriveError, match=says):
        read_sign_records(tmp_path / "signs.json")
