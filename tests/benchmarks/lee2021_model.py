# ruff: noqa: T201
"""Does the graph's posterior promise what it holds, and what if its bias model is wrong?

    python tests/benchmarks/lee2021_model.py [--seeds 200] [--wrong 20]

`lee2021/mcity` with `errors=model`, where the errors are exactly what the drive states, smoothed as
a whole by velocities, fixes and the node: the horizontal RMSE in m over all seeds, the RMS that the
covariances promise, and their ratio. Then, over fewer seeds, with the sigma of the slow errors and
their time constants stated half and double of what they are.
"""

import argparse

import numpy as np

import fgloc
from fgloc.config import load_config
from fgloc.drive import Drive

FACTORS = (0.5, 1.0, 2.0)
STATED = {"sigma_m": 1.0, "tau_s": 1.0}


def main() -> None:
    """Print both parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--wrong", type=int, default=20)
    asked = parser.parse_args()
    print("sigma x  tau x   RMSE m  promised m  ratio  ANEES (plane)")
    line(range(asked.seeds), **STATED)
    for sigma in FACTORS:
        for tau in FACTORS:
            line(range(asked.wrong), sigma_m=sigma, tau_s=tau)


def line(seeds: range, sigma_m: float, tau_s: float) -> None:
    """RMSE, promise and consistency over some seeds, under slow errors stated by these factors."""
    found = np.array([squares(seed, sigma_m, tau_s) for seed in seeds])
    rmse, promised = np.sqrt(found[:, :2].mean(0))
    print(f"{sigma_m:7.1f} {tau_s:6.1f} {rmse:8.3f} {promised:11.3f} {rmse / promised:6.3f} "
          f"{found[:, 2].mean():8.2f}   over {len(seeds)} seeds", flush=True)  # fmt: skip


def squares(seed: int, sigma: float, tau: float) -> tuple[float, float, float]:
    """Mean squared horizontal error and promised variance in m^2, and ANEES, of one drive."""
    drive = fgloc.make("lee2021/mcity", seed=seed, errors="model")
    result = fgloc.smooth(drive, config=load_config(**settings(drive, sigma, tau)))
    scores = fgloc.score(result.trajectory, drive.truth)
    promised = np.trace(result.trajectory.cov[:, :2, :2], axis1=1, axis2=2).mean()
    return scores["horizontal_rmse_m"].value ** 2, promised, scores["anees_horizontal"].value


def settings(drive: Drive, sigma: float, tau: float) -> dict:
    """The graph by velocities, with slow errors stated by some factors of what the drive says."""
    (node,), bias = drive.infrastructure.nodes, drive.rig.gnss_bias
    return {
        "motion": {"kind": "constant-velocity"},
        "gnss": {"bias_sigma_m": sigma * bias.sigma_m, "bias_tau_s": tau * bias.tau_s},
        "detections": {
            "bias_sigma_m": sigma * node.bias_sigma_m, "bias_tau_s": tau * node.bias_tau_s,
        },
    }  # fmt: skip


if __name__ == "__main__":
    main()
