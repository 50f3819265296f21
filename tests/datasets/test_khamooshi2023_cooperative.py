"""Cooperative scenarios: printed starts and speeds, what is hidden, the way to disk and back."""

import numpy as np
import pytest

from fgloc.datasets import make
from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.errors import DriveError, InputError
from fgloc.measurements import PEDESTRIAN

NAMES = ("one-node", "two-nodes", "acceleration", "correspondence", "intersection")


def scenario(name, seed=0, **options):
    return make(f"khamooshi2023/{name}", seed, **options)


def other(drive, name):
    return drive.objects.take(drive.objects.object_id == name)


@pytest.mark.parametrize(
    ("name", "ego", "speed", "then"),
    [
        ("one-node", 20.0, 50.0, 50.0),
        ("two-nodes", 30.0, 30.0, 30.0),
        ("acceleration", 0.0, 40.0, 0.0),
    ],
)
def test_cars_start_where_and_as_fast_as_printed(name, ego, speed, then):
    drive = scenario(name)
    car = other(drive, 1)
    assert drive.truth.p_world_m[0, :2] == pytest.approx([-16, -3.7])
    assert car.p_world_m[0] == pytest.approx([-25, 3.2])
    assert drive.truth.v_world_mps[0, 0] == pytest.approx(ego)
    assert car.v_world_mps[[0, -1], 0] == pytest.approx([speed, then])


@pytest.mark.parametrize("name", NAMES)
def test_velocities_are_those_of_the_positions(name):
    drive = scenario(name)
    for track in np.unique(drive.objects.object_id):
        rows = other(drive, track)
        middle = (rows.p_world_m[2:] - rows.p_world_m[:-2]) / 0.2
        assert middle == pytest.approx(rows.v_world_mps[1:-1], abs=0.2)


def test_the_intersection_is_as_described():
    drive = scenario("intersection")
    assert drive.truth.p_world_m[0, :2] == pytest.approx([4.4, 20.5])
    assert other(drive, 1).p_world_m[0] == pytest.approx([9.2, -14.1])
    assert other(drive, 2).p_world_m[0] == pytest.approx([3, 2.8])
    assert drive.truth.v_world_mps[-1] == pytest.approx([0, 0, 0], abs=1e-9)
    seen = drive.tables["detections"]
    assert len(seen) == 101 * 3  # the node still sees everything
    assert (seen.kind == PEDESTRIAN).sum() == 101


def test_noise_is_what_the_tables_state():
    z = []
    for seed in range(20):
        drive = scenario("one-node", seed)
        own = drive.tables["relative"]
        at = {int(t): k for k, t in enumerate(drive.truth.t_ns)}
        k = np.array([at[int(t)] for t in own.t_ns])
        ray = other(drive, 1).p_world_m[k] - drive.truth.p_world_m[k, :2]
        z.append((own.p_veh_m - ray) / np.sqrt(own.cov_veh_m2[:, 0, 0])[:, None])
    assert np.concatenate(z).var() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_a_drive_with_others_comes_back_from_its_folder(tmp_path, name):
    drive = scenario(name, 3, latency_s=0.1)
    write_drive(drive, tmp_path / "drive")
    back = read_drive(tmp_path / "drive")
    assert back.objects.same_as(drive.objects)
    assert all(back.tables[n].same_as(t) for n, t in drive.tables.items())


def test_a_covariance_that_cannot_be_one_is_refused_with_its_row(tmp_path):
    write_drive(scenario("one-node"), tmp_path / "drive")
    path = tmp_path / "drive" / "relative.csv"
    lines = path.read_text().splitlines()
    cells = lines[2].split(",")
    cells[lines[0].split(",").index("cov_xx_m2")] = "-1"
    path.write_text("\n".join([*lines[:2], ",".join(cells), *lines[3:]]) + "\n")
    with pytest.raises(
        DriveError, match=r"relative.csv:3: the covariance .* not positive definite"
    ):
        read_drive(tmp_path / "drive")


def test_latency_and_loss_out_of_range_are_refused():
    with pytest.raises(InputError, match="loss = 1"):
        scenario("one-node", loss=1.0)
    with pytest.raises(InputError, match="latency_s = -1"):
        scenario("one-node", latency_s=-1.0)
    assert (scenario("one-node", latency_s=0.2).tables["detections"].received_ns
            - scenario("one-node").tables["detections"].t_ns == 200_000_000).all()  # fmt: skip
