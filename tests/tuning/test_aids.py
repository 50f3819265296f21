"""Sigmas of wheels, roadside nodes and a car's axis: claimed wrongly, and found again."""

from dataclasses import replace

import numpy as np
import pytest
from baselines.roadside import roadside_drive
from smoother.without_imu import drive_of

import fgloc
from fgloc.config import DetectionConfig, load_config
from fgloc.datasets import make
from fgloc.tuning import Tuning
from fgloc.tuning.aids import Aids
from fgloc.tuning.rounds import make_rounds


def tuned(drive, **settings):
    """What becomes of the aids' sigmas, by key, and how consistent they are, by source; fixes and
    IMU are as they were made."""
    config = load_config(**settings)
    t_s = (drive.gnss.t_ns - drive.start_ns) / 1e9
    rounds = make_rounds(t_s, 3.0, drive.name)
    found, told, aids = Aids(drive, config).tune(config, config, rounds, lambda text: None)
    return found, {one.key: one for one in told}, {one.source: one for one in aids}


def with_wheel(drive, **columns):
    return drive.with_tables(wheel=replace(drive.tables["wheel"], **columns))


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_sigmas_of_wheels_stated_five_times_wrong_are_found_again(factor):
    """Of 30 speeds that are seen each leaves 1 / sqrt(2); the path is predicted as well as that."""
    drive = make("city", seed=2, duration_s=60.0)
    drive = with_wheel(drive, sigma_mps=drive.tables["wheel"].sigma_mps * factor)
    config, settings, aids = tuned(drive)
    one = settings["vehicle.wheel_sigma_scale"]
    assert one.status == "found" and one.relative_sigma < 0.25
    assert abs(np.log(one.after * factor)) < 3 * one.relative_sigma
    assert config.vehicle.wheel_sigma_scale == one.after and config.vehicle.wheel_speed is None
    assert aids["wheel"].consistent
    assert abs(np.log(aids["wheel"].nis_before)) > 1.5


def test_wheels_that_slip_now_and_then_are_outliers_and_no_matter_of_noise():
    drive = make("city", seed=2, duration_s=60.0)
    speed = np.array(drive.tables["wheel"].speed_mps)
    speed[np.arange(500, 2900, 400)] += 6.0  # at whole seconds, which are those that are taken
    _, settings, aids = tuned(with_wheel(drive, speed_mps=speed))
    assert aids["wheel"].outliers == 6
    assert settings["vehicle.wheel_sigma_scale"].after == pytest.approx(1, abs=0.4)


@pytest.mark.parametrize("start", [0.25, 4.0])
def test_noise_of_what_a_node_sees_is_found_again_among_other_cars_and_ghosts(start):
    drive = roadside_drive(5, duration_s=40.0)
    _, settings, aids = tuned(drive, detections={"sigma_scale": start})
    one = settings["detections.sigma_scale"]
    assert one.status == "found" and one.before == start
    assert abs(np.log(one.after)) < 3 * one.relative_sigma < 0.5
    assert aids["detections"].n >= 10


def test_how_little_a_simulated_car_heaves_is_found_where_it_is_asked_for():
    drive = make("city", seed=2, duration_s=60.0)
    found = tuned(drive, vehicle={"non_holonomic": True, "pitch_rad_per_mps2": 0.0})[1]
    assert found["vehicle.vertical_sigma_mps"].after < 0.01
    assert {"vehicle.lateral_sigma_mps", "vehicle.wheel_sigma_scale"} < found.keys()


def test_without_an_imu_the_fixes_are_found_in_the_same_way():
    drive = drive_of("odometry", duration_s=60.0)
    small = replace(drive.gnss, cov_world_m2=drive.gnss.cov_world_m2 / 9.0)
    tuning = fgloc.tune(drive.with_tables(gnss=small))
    found = {one.key: one for one in tuning.settings}["gnss.sigma_scale"]
    assert found.status == "found"
    assert abs(np.log(found.after / 3)) < 3 * found.relative_sigma < 0.5
    assert {one.source for one in tuning.aids} == {"gnss", "odometry"}
    assert tuning.fixes == len(drive.gnss) and tuning.consistency == ()


def test_sigmas_far_above_what_shows_are_brought_down_to_where_the_drive_tells_no_more():
    """Wheels that claim 5 m/s; what carries the states tells a speed to some tenths of that."""
    drive = drive_of("wheel", duration_s=40.0)
    exact = with_wheel(drive, sigma_mps=np.full(len(drive.tables["wheel"]), 5.0))
    one = tuned(exact)[1]["vehicle.wheel_sigma_scale"]
    assert (one.status, one.relative_sigma) == ("bounded", None)
    assert 0.05 / 5.0 < one.after < 0.1


def test_a_drive_that_says_too_little_of_its_wheels_keeps_their_sigma():
    drive = make("city", seed=2, duration_s=60.0)
    wheel = drive.tables["wheel"]
    few = with_wheel(drive, **vars(wheel.take(np.arange(0, len(wheel), 600))))
    config, settings, aids = tuned(few)
    assert settings["vehicle.wheel_sigma_scale"].status == "kept"
    assert config == load_config() and not aids


def test_what_was_found_is_written_and_remarked_upon():
    drive = make("city", seed=2, duration_s=60.0)
    config, settings, aids = tuned(drive)
    told = replace(aids["wheel"], nis_after=9.0, outliers=3)
    tuning = Tuning("city", config, tuple(settings.values()), (), 600, 0, 1, (told,))
    assert any("3 rows of wheel took no part" in text for text in tuning.remarks)
    assert any("NIS of wheel stays outside its band" in text for text in tuning.remarks)
    narrow = config.model_copy(update={"detections": DetectionConfig(sigma_scale=0.1)})
    assert "slow errors do not show" in " ".join(replace(tuning, config=narrow).remarks)
    assert "# wheel, by all others: " in tuning.to_toml()
    assert "[vehicle]\nwheel_sigma_scale = " in tuning.to_toml()
    assert tuning.to_dict()["aids"][0]["consistent"] is False
