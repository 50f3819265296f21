# ruff: noqa: T201
"""Prints how well each method follows the sway of a post: RMSE and largest error over 20 seeds.

    python tests/benchmarks/sway_table.py [SEEDS] [--figure aliasing.html]

Both cases of Khamooshi (2023), under the thesis's sines and under gusts, with angles as good as
reported (2 % of their amplitude) and thirty times worse, about what a camera gives. Largest errors
are means over the seeds of the largest of a drive. `between` is the RMSE of the displacement at
200 Hz, the estimate interpolated.
"""

import sys
from pathlib import Path

import numpy as np

import fgloc
from fgloc.evaluation import score_posts
from fgloc.report.page import Figure, draw
from fgloc.report.style import BLACK, BLUE, VERMILLION, axis, layout, line
from fgloc.timing import elapsed_s

CASES = [(name, wind, tilt_noise) for name in ("low", "high") for wind in ("sines", "kaimal")
         for tilt_noise in (1.0, 30.0)]  # fmt: skip
COLUMNS = ("x_rmse_mm", "x_max_mm", "y_rmse_mm", "y_max_mm", "roll_rmse_mrad", "roll_max_mrad",
           "pitch_rmse_mrad", "pitch_max_mrad", "between_rmse_mm", "anees")  # fmt: skip
METHODS = {
    "poses alone": lambda drive: fgloc.baseline(drive, "raw:node_poses"),
    "khamooshi2023-uio": lambda drive: fgloc.baseline(drive, "khamooshi2023-uio"),
    "sway-kf": lambda drive: fgloc.baseline(drive, "sway-kf"),
    "graph, filtered": lambda drive: fgloc.smooth(drive, "fixed-lag"),
    "graph, smoothed": fgloc.smooth,
}
SEARCHED = "graph, smoothed, post sought"


def sought(drive: fgloc.Drive) -> fgloc.Result:
    return fgloc.smooth(drive, settings=["posts.estimate_mode=true"])


def one_case(name: str, wind: str, tilt_noise: float, seeds: int) -> None:
    print(f"\nsway-{name}, {wind}, angle noise times {tilt_noise:g}")
    print(
        f"{'':30}"
        + "".join(f"{column.replace('_rmse', '').replace('_m', ' m'):>13}" for column in COLUMNS)
    )
    drives = [fgloc.make(f"khamooshi2023/sway-{name}", seed=seed, wind=wind, tilt_noise=tilt_noise)
              for seed in range(seeds)]  # fmt: skip
    methods = METHODS | ({SEARCHED: sought} if wind == "kaimal" else {})
    for method, run in methods.items():
        scores = [score_posts(run(drive).posts, drive) for drive in drives]
        cells = []
        for column in COLUMNS:
            values = [one[f"posts.isn-1.{column}"].value for one in scores]
            cells.append("" if None in values else f"{np.mean(values):.3g}")
        print(f"{method:30}" + "".join(f"{cell:>13}" for cell in cells), flush=True)


def aliasing(path: Path) -> None:
    """Two seconds of `sway-high` and the spectrum of its load, true and sampled."""
    drive = fgloc.make("khamooshi2023/sway-high", seed=0)
    truth, posts = drive.post_truth, fgloc.smooth(drive).posts
    poses, start = drive.tables["node_poses"], drive.start_ns
    shown = [(truth, "truth, 200 Hz", BLACK), (posts, "graph, smoothed", VERMILLION)]
    swing = [line(elapsed_s(one.t_ns, start), 1000 * one.p_node_m[:, 0], name, colour)
             for one, name, colour in shown]  # fmt: skip
    swing.append(line(elapsed_s(poses.t_ns, start), 1000 * poses.p_node_m[:, 0], "poses, 10 Hz",
                      BLUE) | {"mode": "markers"})  # fmt: skip
    load = acceleration(drive)
    spectra = [line(*spectrum(load, 200), "load, 200 Hz", BLACK),
               line(*spectrum(load[::20], 10), "load, sampled at 10 Hz", BLUE)]  # fmt: skip
    specs = {
        "swing": {"data": swing, "layout": layout(360, xaxis=axis("s", range=[10, 12]),
                                                  yaxis=axis("x (mm)"))},
        "load": {"data": spectra, "layout": layout(360, xaxis=axis("Hz", range=[0, 12]),
                                                   yaxis=axis("acceleration (m/s^2)"))},
    }  # fmt: skip
    from plotly.offline import get_plotlyjs

    figures = [Figure(key, key, "", draw(key, spec)) for key, spec in specs.items()]
    body = "".join(figure.html for figure in figures)
    path.write_text(f"<script>{get_plotlyjs()}</script>{body}", encoding="utf-8")
    print(f"figure: {path}")


def acceleration(drive: fgloc.Drive) -> np.ndarray:
    """What the load does to the tip along x, from the truth: x'' + 2 xi w x' + w^2 x."""
    truth, post = drive.post_truth, drive.infrastructure.posts[0]
    w, x, v = 2 * np.pi * post.frequency_hz, truth.p_node_m[:, 0], truth.v_node_mps[:, 0]
    return np.gradient(v, 1 / 200) + 2 * post.damping * w * v + w**2 * x


def spectrum(x: np.ndarray, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    x = x[: len(x) // 10 * 10]
    amplitude = np.abs(np.fft.rfft(x)) / len(x)
    amplitude[1:-1] *= 2
    return np.fft.rfftfreq(len(x), 1 / rate_hz), amplitude


if __name__ == "__main__":
    given = [arg for arg in sys.argv[1:] if arg.isdecimal()]
    if "--figure" in sys.argv:
        aliasing(Path(sys.argv[sys.argv.index("--figure") + 1]))
    for case in CASES:
        one_case(*case, int(given[0]) if given else 20)
