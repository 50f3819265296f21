"""Configuration: files, settings and overrides, and faults told all at once where they are."""

from pathlib import Path

import pytest

from fgloc.config import SmoothConfig, load_config, merge
from fgloc.errors import ConfigError


def written(folder: Path, text: str) -> Path:
    path = folder / "run.toml"
    path.write_text(text, encoding="utf-8")
    return path


def fault(*args, **kwargs) -> str:
    with pytest.raises(ConfigError) as caught:
        load_config(*args, **kwargs)
    return str(caught.value)


def test_nothing_given_is_the_defaults():
    assert load_config() == SmoothConfig()


def test_a_file_a_setting_and_an_override_each_come_before_the_last(tmp_path):
    path = written(tmp_path, "lag_s = 1\nseed = 1\nkeyframe_interval_s = 1.5\n")
    config = load_config(path, ["lag_s=2", "seed=2"], lag_s=3.0)
    assert (config.keyframe_interval_s, config.seed, config.lag_s) == (1.5, 2, 3.0)


def test_a_file_is_laid_over_the_base_section_by_section(tmp_path):
    base = load_config(settings=["gnss.loss=none", "gnss.loss_width=2"])
    config = load_config(written(tmp_path, "[gnss]\nloss_width = 5\n"), base=base)
    assert (config.gnss.loss, config.gnss.loss_width) == ("none", 5)


def test_an_override_that_is_none_is_passed_over():
    assert load_config(settings=["mode=fixed-lag"], mode=None).mode == "fixed-lag"


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("gnss.loss=cauchy", "cauchy"),
        ('gnss.loss="cauchy"', "cauchy"),
        (" gnss.loss = cauchy ", "cauchy"),
    ],
)
def test_a_setting_reaches_into_a_section_with_or_without_quotes(setting, value):
    assert load_config(settings=[setting]).gnss.loss == value


def test_settings_hold_numbers_and_truths():
    config = load_config(settings=["smoothed=true", "solver.max_iterations=7", "lag_s=2.5"])
    assert (config.smoothed, config.solver.max_iterations, config.lag_s) == (True, 7, 2.5)


def test_of_settings_of_one_key_the_last_one_counts():
    assert load_config(settings=["lag_s=2", "lag_s=3"]).lag_s == 3


def test_all_faults_are_named_at_once(tmp_path):
    text = fault(written(tmp_path, "mod = 'batch'\nlag_s = -1\n[gnss]\nloss = 'tukey'\nlosss = 1"))
    assert text.startswith(f"{tmp_path / 'run.toml'}: ")
    assert "unknown key 'mod'; the nearest valid key is 'mode'" in text
    assert "lag_s = -1: Input should be greater than 0" in text
    assert "gnss.loss = 'tukey': Input should be 'none', 'huber' or 'cauchy'" in text
    assert "unknown key 'gnss.losss'; the nearest valid key is 'gnss.loss'" in text


def test_a_fault_is_told_where_it_was_given(tmp_path):
    path = written(tmp_path, "lag_s = -1\n")
    text = fault(path, ["gnss.los=none"], mode="bath")
    assert f"{path}: lag_s = -1: " in text
    assert "configuration: mode = 'bath': " in text
    assert "--set: unknown key 'gnss.los'; the nearest valid key is 'gnss.loss'" in text


def test_a_setting_is_not_blamed_on_the_file_it_overrides(tmp_path):
    assert fault(written(tmp_path, "lag_s = 5\n"), ["lag_s=0"]).startswith("--set: lag_s = 0: ")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_a_setting_must_be_a_finite_number(value):
    assert "finite number" in fault(settings=[f"gnss.sigma_scale={value}"])


def test_a_setting_for_a_section_is_told_as_one():
    assert fault(settings=["gnss=none"]).startswith("--set: gnss = 'none': ")


def test_a_setting_below_a_plain_value_is_told_as_one():
    assert fault(settings=["mode.x=1"]).startswith("--set: mode = {'x': 1}: ")


def test_a_setting_without_a_value_is_refused():
    assert fault(settings=["gnss.loss"]) == (
        "--set gnss.loss: expected key=value, e.g. gnss.loss=none"
    )


def test_a_file_that_is_missing_is_named(tmp_path):
    path = tmp_path / "none.toml"
    assert fault(path) == f"{path}: No such file or directory; give the path of a TOML file"


@pytest.mark.parametrize("content", [b"lag_s = = 1", b"lag_s = 1\xff"])
def test_a_file_that_is_no_toml_is_named(tmp_path, content):
    path = tmp_path / "run.toml"
    path.write_bytes(content)
    assert fault(path).startswith(f"{path}: not valid TOML: ")


def test_a_configuration_cannot_be_changed_in_place():
    with pytest.raises(ValueError, match="frozen"):
        load_config().lag_s = 2.0


def test_merging_leaves_both_sides_as_they_were():
    base, update = {"a": {"b": 1, "c": 2}, "d": 3}, {"a": {"c": 5}, "d": {"e": 6}}
    assert merge(base, update) == {"a": {"b": 1, "c": 5}, "d": {"e": 6}}
    assert base == {"a": {"b": 1, "c": 2}, "d": 3}
    assert update == {"a": {"c": 5}, "d": {"e": 6}}


def test_a_word_alone_chooses_the_solver_of_the_batch():
    solver = load_config(None, ["solver=gtsam", "solver.max_iterations=7"]).solver
    assert (solver.batch, solver.max_iterations) == ("gtsam", 7)
    with pytest.raises(ConfigError, match=r"--set: solver.batch = 'qr'"):
        load_config(None, ["solver=qr"])
