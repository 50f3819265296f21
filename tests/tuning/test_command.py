"""`fgloc tune` as it is typed."""

import json
import tomllib

import pytest

from fgloc.cli import main


@pytest.fixture
def run(capsys):
    """Exit status, standard output, standard error of a command."""

    def call(*arguments):
        status = main([str(argument) for argument in arguments])
        return (status, *capsys.readouterr())

    return call


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives") / "city"
    assert (
        main(["make", "city", "--seed", "5", "--set", "duration_s=31", "--out", str(folder)]) == 0
    )
    return folder


def test_mems_rtk_gets_more_consistent_and_is_smoothed_with_what_was_found(run, tmp_path):
    config = tmp_path / "new" / "tuned.toml"
    status, out, err = run("tune", "mems-rtk", "--json", "--out", config)
    assert (status, err) == (0, "")
    found = json.loads(out)
    for gap in found["consistency"]:
        assert gap["n"] == 120 and gap["low"] < 1 < gap["high"]
    for gap in found["consistency"][:2]:
        assert abs(gap["nis_after"] - 1) < abs(gap["nis_before"] - 1)
        assert gap["log_likelihood_after"] > gap["log_likelihood_before"]
    assert tomllib.loads(config.read_text()) == found["config"]
    anees = {}
    for name, more in (("given", ()), ("tuned", ("--config", config))):
        status, out, _ = run("smooth", "mems-rtk", *more, "--no-report", "--json",
                             "--out", tmp_path / name)  # fmt: skip
        assert status == 0
        anees[name] = json.loads(out)["metrics"]["anees"]["value"]
    assert 1 < anees["tuned"] < anees["given"]  # the truth had no part in the tuning


def test_tables_say_what_was_found_and_where_it_is(run, city, tmp_path):
    config = tmp_path / "tuned.toml"
    status, out, _ = run("tune", city, "--outage", "1", "--set", "gnss.sigma_scale=2",
                         "--out", config)  # fmt: skip
    assert status == 0
    assert "city: noise from 311 fixes" in out and "kept" in out and "found" in out
    assert f"use it with fgloc smooth {city} --config {config}" in out
    again = tmp_path / "again.toml"
    assert run("tune", city, "--outage", "1", "--config", config, "--out", again)[0] == 0
    first, second = (tomllib.loads(path.read_text())["gnss"] for path in (config, again))
    assert second["sigma_scale"] == pytest.approx(first["sigma_scale"], rel=0.02)


def test_a_file_that_is_there_is_replaced_only_on_request(run, city, tmp_path):
    config = tmp_path / "mine.toml"
    config.write_text("mode = 'batch'\n")
    status, out, err = run("tune", city, "--out", config)
    assert (status, out) == (2, "") and "is there already; give another name or --overw" in err
    assert config.read_text() == "mode = 'batch'\n"
    assert run("tune", city, "--out", config, "--overwrite", "--outage", "1")[0] == 0
    assert "sigma_scale" in config.read_text()
    assert "is a folder; give the name of a file" in run("tune", city, "--out", tmp_path)[2]


def test_bad_input_is_one_line(run, tmp_path):
    out = tmp_path / "tuned.toml"
    for arguments, message in (
        (
            ("city", "--seed", "1", "--set", "gnss.sigma_scal=2"),
            "nearest valid key is 'gnss.sigma_",
        ),
        (("city", "--outage", "0"), "outage_s = 0.0: expected seconds above 0"),
        (("cityy",), "city"),
    ):
        status, text, err = run("tune", *arguments, "--out", out)
        assert (status, text) == (2, "") and message in err and err.count("\n") == 1
    assert not out.exists()
