"""Factor-graph localization for vehicles that drive past smart infrastructure.

    import fgloc

    drive = fgloc.load("city", seed=3)                   # a name, a folder or a Drive
    result = fgloc.smooth(drive, mode="batch")           # .trajectory .verdicts .summary
    scores = fgloc.score(result.trajectory, drive.truth) # {name: Metric}

Importing this costs next to nothing: each name is imported when it is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fgloc.api import baseline, compare, doctor, load, make, score, smooth, tune
    from fgloc.config import SmoothConfig
    from fgloc.diagnosis.finding import Finding
    from fgloc.drive import About, Drive, GnssBias, ImuNoise, Rig
    from fgloc.errors import ConfigError, DriveError, FglocError, InputError, SolverError
    from fgloc.evaluation.comparison import Comparison, Method
    from fgloc.evaluation.metric import Metric
    from fgloc.frames import Origin
    from fgloc.infrastructure import Infrastructure, Node, Post
    from fgloc.measurements import (
        EnuVelocities,
        GnssFixes,
        ImuSamples,
        NodeDetections,
        NodePoses,
        Odometry,
        SteeringAngles,
        WheelSpeeds,
    )
    from fgloc.posts import PostStates
    from fgloc.result import Event, Result
    from fgloc.trajectory import Trajectory
    from fgloc.tuning.result import Tuning
    from fgloc.verdicts import SourceVerdicts, Verdict

    __version__: str

_HOME = {
    "baseline": "api", "compare": "api", "doctor": "api", "load": "api", "make": "api",
    "score": "api", "smooth": "api", "tune": "api", "Comparison": "evaluation.comparison",
    "Method": "evaluation.comparison", "Metric": "evaluation.metric", "SmoothConfig": "config",
    "Finding": "diagnosis.finding", "About": "drive", "Drive": "drive", "ImuNoise": "drive",
    "Rig": "drive", "ConfigError": "errors", "DriveError": "errors", "FglocError": "errors",
    "InputError": "errors", "SolverError": "errors", "Origin": "frames",
    "GnssFixes": "measurements", "ImuSamples": "measurements", "SteeringAngles": "measurements",
    "WheelSpeeds": "measurements", "EnuVelocities": "measurements", "Odometry": "measurements",
    "NodeDetections": "measurements", "NodePoses": "measurements", "Post": "infrastructure",
    "PostStates": "posts", "Infrastructure": "infrastructure", "Node": "infrastructure",
    "GnssBias": "drive", "Event": "result", "Result": "result",
    "Trajectory": "trajectory", "Tuning": "tuning.result", "SourceVerdicts": "verdicts",
    "Verdict": "verdicts",
}  # fmt: skip
"""The module that each public name comes from."""

__all__ = [
    "About",
    "Comparison",
    "ConfigError",
    "Drive",
    "DriveError",
    "EnuVelocities",
    "Event",
    "FglocError",
    "Finding",
    "GnssBias",
    "GnssFixes",
    "ImuNoise",
    "ImuSamples",
    "Infrastructure",
    "InputError",
    "Method",
    "Metric",
    "Node",
    "NodeDetections",
    "NodePoses",
    "Odometry",
    "Origin",
    "Post",
    "PostStates",
    "Result",
    "Rig",
    "SmoothConfig",
    "SolverError",
    "SourceVerdicts",
    "SteeringAngles",
    "Trajectory",
    "Tuning",
    "Verdict",
    "WheelSpeeds",
    "__version__",
    "baseline",
    "compare",
    "doctor",
    "load",
    "make",
    "score",
    "smooth",
    "tune",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("fgloc")
    elif name in _HOME:
        value = getattr(importlib.import_module(f"fgloc.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'fgloc' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
