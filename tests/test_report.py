"""The report: one file, complete, escaped, and in order for every kind of drive."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from fgloc import frames
from fgloc.drive import About, Drive, Rig
from fgloc.errors import InputError
from fgloc.evaluation import errors, gnss_outages, score_errors
from fgloc.frames import Origin
from fgloc.measurements import GnssFixes, ImuSamples
from fgloc.report import tables, write_report
from fgloc.report.plan import ellipse_outlines, plan_figure
from fgloc.report.scene import scene
from fgloc.report.series import error_figure, nis_figure, timeline_figure
from fgloc.report.style import MAX_POINTS, band, every, peaks, with_gaps
from fgloc.result import Event, Result
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict

S = 1_000_000_000
START = 1_751_900_000 * S
ANTENNA = np.array([1.2, 0.0, 1.6])


def made_drive(duration_s=120.0, *, seed=0, name="made/loop"):
    """A loop at 10 m/s with GNSS at 2 Hz, two outages and some wild fixes; and its truth."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, duration_s, 0.1)
    yaw = 0.4 + 0.25 * np.sin(2 * np.pi * t / 40) + 2 * np.pi * t / duration_s
    v = 10 * np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(t)], -1)
    p = np.cumsum(v * 0.1, axis=0)
    t_ns = START + np.rint(t * S).astype(np.int64)
    truth = Trajectory(t_ns, p, frames.yaw_matrix(yaw), v)
    rows = np.arange(0, len(t), 5)
    rows = rows[~(((t[rows] > 40) & (t[rows] < 52)) | ((t[rows] > 80) & (t[rows] < 95)))]
    antenna = p[rows] + truth.attitude()[rows] @ ANTENNA
    fixes = antenna + rng.normal(0, 1.0, antenna.shape)
    fixes[::17] += rng.normal(0, 25.0, fixes[::17].shape)
    fixes_t = t_ns[rows]
    cov = np.tile(np.eye(3), (len(rows), 1, 1))
    nan = np.full(fixes.shape, np.nan)
    imu_t = START + np.arange(0, int(duration_s * S), S // 100)
    zeros = np.zeros((len(imu_t), 3))
    gnss = GnssFixes(fixes_t, fixes_t, fixes, cov, nan)
    return Drive(
        name, Origin(42.3, -83.7, 250.0), Rig(p_veh_ant_m=ANTENNA),
        {"gnss": gnss, "imu": ImuSamples(imu_t, imu_t, zeros, zeros)}, truth,
        About("A made-up loop with two outages", "CC0", simulated=True),
    )  # fmt: skip


def made_result(drive, *, seed=1, cov=True):
    """An estimate whose errors and covariance grow in the outages, and its verdicts."""
    rng = np.random.default_rng(seed)
    truth = drive.truth
    t = (truth.t_ns - START) / S
    since = np.where((t > 40) & (t < 52), t - 40, np.where((t > 80) & (t < 95), t - 80, 0))
    sigma = 0.3 + 0.02 * since**1.7
    smooth = np.convolve(rng.normal(size=len(t) + 60), np.ones(61) / np.sqrt(61), "valid")
    p = truth.p_world_m + np.stack([sigma * smooth, -sigma * smooth[::-1], 0.3 * sigma], -1)
    yaw = truth.yaw_rad + 0.01 * smooth
    P = np.zeros((len(t), 6, 6))
    P[:, range(6), range(6)] = np.stack([sigma**2] * 3 + [np.full(len(t), 1e-4)] * 3, -1)
    estimate = Trajectory(
        truth.t_ns, p, frames.yaw_matrix(yaw), truth.v_world_mps, P if cov else None
    )
    return Result(
        estimate, made_verdicts(drive, rng), {"wall_s": 1.25, "realtime_factor": 96.0},
        "graph-batch", False, events=(Event(START + 40 * S, "outage", "GNSS lost for 12.0 s"),),
        config={
            "mode": "batch", "gnss": {"loss": "huber", "sigma_scale": 1.0},
            "versions": {"python": "3.99", "gtsam": "4.88"},
        },
    )  # fmt: skip


def made_verdicts(drive, rng):
    gnss = SourceVerdicts.of("gnss", drive.gnss, Verdict.USED)
    n = len(gnss)
    gnss.nis[:] = rng.chisquare(3, n)
    gnss.dof[:], gnss.threshold[:] = 3, 30.66
    wild = np.arange(0, n, 17)
    gnss.nis[wild] = 400.0
    gnss.set(wild, Verdict.GATED, "NIS above the gate: 400 > 30.7")
    gnss.set(np.arange(5, n, 23), Verdict.DOWN_WEIGHTED, "robust loss")
    return {"gnss": gnss, "imu": SourceVerdicts.of("imu", drive.imu, Verdict.USED)}


def written(tmp_path, drive, result, *, judged=True):
    """The report's text, with errors and scores where there is truth."""
    e = errors(result.trajectory, drive.truth) if judged and drive.truth is not None else None
    scores = None if e is None else score_errors(e, outages=gnss_outages(result))
    path = tmp_path / "report.html"
    write_report(path, drive=drive, result=result, scores=scores, errors=e)
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
    return path.read_text(encoding="utf-8")


class Page(HTMLParser):
    """Headings, table cells and the addresses that a page would load."""

    def __init__(self, text):
        super().__init__()
        self.loads, self.headings, self.ids, self._in = [], [], set(), ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self._in = tag
        self.ids.add(values.get("id"))
        self.loads += [v for k, v in attrs if k in ("src", "href", "srcset", "data", "action")]

    def handle_data(self, data):
        if self._in in ("h1", "h2") and data.strip():
            self.headings.append(data.strip())


def without_scripts(text):
    return re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)


def test_report_is_one_file_that_loads_nothing_and_holds_every_section(tmp_path):
    drive = made_drive()
    text = written(tmp_path, drive, made_result(drive))
    page = Page(text)
    assert page.loads == ["data:,"]
    assert "http" not in without_scripts(text)
    assert not re.search(r"(src|href)\s*=\s*[\"']?https?:", without_scripts(text))
    assert page.headings == [
        "made/loop", "Plan view", "Errors over time", "Distribution of errors",
        "Error growth in GNSS outages", "Normalised innovations",
        "What became of each measurement", "Protection levels",
        "Requirements of automated driving", "Metrics", "Measurements by verdict", "GNSS outages",
        "Events", "How it was made",
    ]  # fmt: skip
    assert 3e6 < len(text) < 9e6
    for shown in ("horizontal_rmse_m", "smoothed: each state draws", "GNSS lost for 12.0 s",
                  "gnss.sigma_scale", "Software versions", 'lang="en"', "simulated"):  # fmt: skip
        assert shown in text
    assert '"displaylogo": false' in text and '"showSendToCloud": false' in text


def test_the_versions_are_those_of_the_run(tmp_path):
    drive = made_drive()
    result = made_result(drive)
    text = written(tmp_path, drive, result)
    assert '<th scope="row">gtsam</th><td>4.88</td>' in text and "3.99" in text
    assert "versions.gtsam" not in text and result.config["versions"]
    unknown = written(tmp_path, drive, replace(result, config={"mode": "batch"}))
    assert "Software versions" not in unknown


def test_a_causal_result_says_so_and_shows_its_smoothed_states(tmp_path):
    drive = made_drive()
    result = made_result(drive)
    causal = replace(result, causal=True, smoothed=drive.truth, method="graph-lag")
    text = written(tmp_path, drive, causal)
    assert "causal: each state as it was known" in text and "smoothed afterwards" in text


def test_without_truth_the_claims_are_shown(tmp_path):
    drive = made_drive()
    text = written(tmp_path, replace(drive, truth=None), made_result(drive))
    page = Page(text)
    assert "Claimed uncertainty over time" in page.headings
    assert not {"errors", "cdf", "growth", "metrics"} & page.ids
    assert "has no truth" in text and "claimed horizontal sigma" in text


def test_names_and_reasons_are_escaped(tmp_path):
    drive = made_drive(name="<script>alert(1)</script>")
    result = made_result(drive)
    result.verdicts["gnss"].set(0, Verdict.GATED, "<img src=x onerror=alert(2)>")
    evil = Event(START, "<b>kind</b>", "</script><script>alert(3)</script>")
    text = written(tmp_path, drive, replace(result, events=(evil,), method="a<b>"))
    for raw in ("<script>alert", "<img src=x", "<b>kind", "a<b>"):
        assert raw not in text
    assert "&lt;script&gt;alert(1)" in text


@pytest.mark.parametrize("tables_kept", [(), ("imu",)])
def test_without_gnss(tmp_path, tables_kept):
    drive = made_drive()
    result = made_result(drive)
    bare = replace(drive, tables={k: drive.tables[k] for k in tables_kept})
    result = replace(result, verdicts={k: result.verdicts[k] for k in tables_kept})
    page = Page(written(tmp_path, bare, result))
    assert "plan" in page.ids and "nis" not in page.ids and "outages" not in page.ids


def test_without_covariance_and_without_attitude(tmp_path):
    drive = made_drive()
    truth = drive.truth
    bare = replace(drive, truth=Trajectory(truth.t_ns, truth.p_world_m))
    text = written(tmp_path, bare, made_result(drive, cov=False))
    assert "its course gives the directions" in text
    assert "the estimate has no covariance" in text
    positions = Trajectory(truth.t_ns, truth.p_world_m)
    result = replace(made_result(drive), trajectory=positions)
    text = written(tmp_path, bare, result)
    assert "No yaw error: the estimate has no attitude" in text
    page = Page(written(tmp_path, replace(drive, truth=None), result))
    assert "sigmas" not in page.ids and "plan" in page.ids


def test_an_estimate_without_states_or_without_scorable_truth(tmp_path):
    drive = made_drive()
    result = made_result(drive)
    empty = replace(result, trajectory=result.trajectory.take(slice(0, 0)), verdicts={})
    text = written(tmp_path, drive, empty)
    assert "none of it could be scored" in text and "no truth row could be scored" in text


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    drive = made_drive()
    with pytest.raises(InputError, match="cannot be written"):
        write_report(
            tmp_path / "missing" / "report.html", drive=drive, result=made_result(drive),
            scores=None, errors=None,
        )  # fmt: skip


def test_long_drives_are_thinned_and_the_caption_says_so(tmp_path):
    drive = made_drive(1200.0)
    result = made_result(drive)
    of = scene(drive, result, errors(result.trajectory, drive.truth))
    for spec in (plan_figure(of), error_figure(of), nis_figure(of), timeline_figure(of)):
        assert max(len(trace["x"]) for trace in spec["data"]) <= 1.2 * MAX_POINTS
    assert "Thinned from 12,000 to 5,000 points" in written(tmp_path, drive, result)


# --- parts


def test_every_and_peaks_keep_ends_and_extremes():
    assert every(3).tolist() == [0, 1, 2] and every(0).tolist() == []
    rows = every(100_001, 101)
    assert len(rows) == 101 and rows[0] == 0 and rows[-1] == 100_000
    y = np.zeros(100_000)
    y[54_321], y[777] = 9.0, -3.0
    rows = peaks(y, 1000)
    assert len(rows) <= 1001 and {54_321, 777, 99_999} <= set(rows.tolist())


def test_lines_break_where_time_jumps():
    t, y = with_gaps(np.array([0.0, 1, 5, 6]), np.array([1.0, 2, 3, 4]), longest_s=2)
    np.testing.assert_array_equal(t, [0, 1, np.nan, 5, 6])
    np.testing.assert_array_equal(y, [1, 2, np.nan, 3, 4])
    area = band(np.array([0.0, 1, 5, 6]), np.array([1.0, 2, 3, 4]), 2, "#0072B2", "band")
    np.testing.assert_array_equal(area["x"], [0, 1, 1, 0, np.nan, 5, 6, 6, 5, np.nan])
    np.testing.assert_array_equal(area["y"], [1, 2, -2, -1, np.nan, 3, 4, -4, -3, np.nan])


def test_ellipses_reach_as_far_as_chi_square_says():
    P = np.zeros((1, 6, 6))
    P[0, :2, :2] = np.diag([4.0, 1.0])
    outline = ellipse_outlines(
        Trajectory(np.array([START]), np.array([[10.0, 20, 0]]), None, None, P), np.array([0])
    )[0] - [10, 20]
    np.testing.assert_allclose(
        np.abs(outline).max(axis=0), np.sqrt(5.991) * np.array([2, 1]), rtol=1e-3
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.01234, "0.0123"), (1.234, "1.23"), (99.94, "99.9"), (12345.6, "12,346"),
     (1.2e-9, "1.20e-09"), (-0.5, "-0.500")],
)  # fmt: skip
def test_numbers_are_short_and_honest(value, text):
    assert tables.number(value) == text
