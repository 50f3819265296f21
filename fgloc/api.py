"""What fgloc does, as functions: open or make a drive, tune, estimate, score, compare.

The same functions stand behind the command line. A drive is a `Drive`, a drive folder, or a name
that `fgloc datasets` lists.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fgloc.config import Mode, SmoothConfig, load_config
from fgloc.drive import Drive
from fgloc.errors import InputError
from fgloc.evaluation.comparison import Comparison, Method, compare_methods
from fgloc.evaluation.metric import Metric
from fgloc.result import Result
from fgloc.trajectory import Trajectory

if TYPE_CHECKING:
    from fgloc.diagnosis.finding import Finding
    from fgloc.perception.pipeline import Perceived, Seen
    from fgloc.perception.recording import Recording
    from fgloc.perception.settings import PerceiveConfig
    from fgloc.tuning.result import Tuning

DriveLike = Drive | str | Path


def load(drive: DriveLike, /, *, seed: int | None = None, **options: Any) -> Drive:
    """The drive of a name or folder; a `Drive` is given back as it is.

    A scenario takes a seed and its options, such as `duration_s`. Raises InputError for an
    unknown name (with the nearest valid one) or option, DriveError for a faulty folder.
    """
    if not isinstance(drive, Drive):
        from fgloc.datasets import open_drive

        return open_drive(drive, seed=seed, **options)
    if seed is not None or options:
        raise InputError(
            f"drive {drive.name!r} is made already; a seed and options go with a scenario's name"
        )
    return drive


def make(scenario: str, /, *, seed: int = 0, **options: Any) -> Drive:
    """A simulated drive; equal seeds and options give equal drives, bit for bit."""
    from fgloc.datasets import make as make_scenario

    return make_scenario(scenario, seed, **options)


def perceive(
    recording: "Recording | str | Path",
    *,
    config: "str | Path | PerceiveConfig | None" = None,
    settings: Iterable[str] = (),
    show: "Callable[[int, int, Seen], None]" = lambda done, of, seen: None,
    **overrides: Any,
) -> "tuple[Drive, Perceived]":
    """What a node makes of a recording of its sensors: a drive with its detections, and what was
    dropped on the way.

    recording  a recording, or its folder
    config     a TOML file or a `PerceiveConfig`; settings as text and overrides are laid over it
    show       is told, after each frame, how many of how many are done, and what was seen

    Raises InputError for anything wrong in these, or where no object was seen; DriveError where the
    folder is faulty.
    """
    from fgloc.config import load_model
    from fgloc.datasets.perceived_drive import drive_of, map_of
    from fgloc.datasets.perception_recording import read_recording
    from fgloc.perception.pipeline import perceive as run
    from fgloc.perception.recording import Recording
    from fgloc.perception.settings import PerceiveConfig

    base = config if isinstance(config, PerceiveConfig) else None
    path = None if base is not None or config is None else Path(str(config))
    in_force = load_model(PerceiveConfig, path, settings, base, overrides)
    opened = recording if isinstance(recording, Recording) else read_recording(recording)
    by_map = in_force.place.point == "idw" and in_force.place.idw_file
    found = run(opened, in_force, map_of(opened, by_map) if by_map else None, show)
    return drive_of(opened, found), found


def smooth(
    drive: DriveLike,
    mode: Mode | None = None,
    *,
    config: str | Path | SmoothConfig | None = None,
    lag_s: float | None = None,
    smoothed: bool = False,
    settings: Iterable[str] = (),
    seed: int | None = None,
) -> Result:
    """Estimate a drive's trajectory with the graph.

    mode      'batch' (the default: the whole drive at once), 'incremental' or 'fixed-lag'
    config    a TOML file or a `SmoothConfig`; everything else is laid over it
    lag_s     of 'fixed-lag', in seconds
    smoothed  causal modes: give the last estimate of every state as well
    settings  single settings as text: `["gnss.loss=none"]`
    seed      of a scenario that is given by name; without one, the configuration's

    Raises InputError for anything wrong in these, DriveError where the drive lacks what the graph
    needs, SolverError where it cannot be solved.
    """
    in_force = configure(mode, config=config, lag_s=lag_s, smoothed=smoothed, settings=settings,
                         seed=seed)  # fmt: skip
    opened, in_force = prepare(drive, in_force, seed)
    from fgloc.smoother import smooth as run

    return run(opened, in_force)


def configure(
    mode: Mode | None = None,
    *,
    config: str | Path | SmoothConfig | None = None,
    lag_s: float | None = None,
    smoothed: bool = False,
    settings: Iterable[str] = (),
    seed: int | None = None,
) -> SmoothConfig:
    """The configuration that `smooth` runs with; InputError for what is wrong or contradicts."""
    base = config if isinstance(config, SmoothConfig) else None
    path = None if base is not None or config is None else Path(str(config))
    in_force = load_config(path, settings, base, mode=mode, lag_s=lag_s, seed=seed,
                           smoothed=smoothed or None)  # fmt: skip
    if lag_s is not None and in_force.mode != "fixed-lag":
        raise InputError(f"a lag goes with mode fixed-lag, not with {in_force.mode}")
    if smoothed and in_force.mode == "batch":
        raise InputError(
            "smoothed goes with the causal modes incremental and fixed-lag; what batch gives is "
            "smoothed already"
        )
    return in_force


def prepare(
    drive: DriveLike, config: SmoothConfig, seed: int | None = None
) -> tuple[Drive, SmoothConfig]:
    """The drive opened, and the configuration with the seed that a scenario was made with.

    A seed in a configuration is that of the run it was saved from: it makes a scenario again and
    says nothing to a recorded drive. A seed given beside it must fit the drive.
    """
    from fgloc.datasets.registry import DEFAULT_SEED

    if not is_scenario(drive):
        return load(drive, seed=seed), config
    used = DEFAULT_SEED if config.seed is None else config.seed
    return load(drive, seed=used), config.model_copy(update={"seed": used})


def doctor(drive: DriveLike, *, seed: int | None = None) -> "list[Finding]":
    """What is wrong with a drive, before it is fused; each finding has its numbers and a remedy.

    A folder that cannot be read as a drive is a finding too, and the tables that can are checked.
    Raises InputError for an unknown name, DriveError where there is no drive at all.
    """
    from fgloc.datasets.drive_folder import is_drive_folder
    from fgloc.diagnosis import diagnose, diagnose_folder

    if not isinstance(drive, Drive) and seed is None and is_drive_folder(drive):
        return diagnose_folder(drive)
    return diagnose(load(drive, seed=seed))


def tune(
    drive: DriveLike,
    *,
    config: str | Path | SmoothConfig | None = None,
    settings: Iterable[str] = (),
    outage_s: float = 20.0,
    seed: int | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> "Tuning":
    """Find the noise of a drive's sources from the drive itself; `.config` is ready for `smooth`.

    The search starts from the rig's noise and the configuration; see `fgloc.tuning`. `outage_s` is
    the longest outage for which the noise is to hold, and `tell` is given a line at every step.
    Truth is not used. Raises InputError where the drive is too short or has too few fixes,
    DriveError where it lacks what the graph needs, SolverError where it cannot be solved.
    """
    from fgloc.tuning import tune as run

    opened, in_force = prepare(drive, configure(config=config, settings=settings, seed=seed), seed)
    return run(opened, in_force, outage_s, tell)


def baseline(drive: DriveLike, method: str, *, seed: int | None = None) -> Result:
    """Estimate a drive's trajectory with a documented filter; `raw:SOURCE` is that source alone.

    Raises InputError for an unknown method, with the nearest valid name and the list of them.
    """
    from fgloc import baselines

    baselines.check(method)
    return baselines.run(load(drive, seed=seed), method)


def score(estimate: Trajectory, truth: Trajectory | None, **options: Any) -> dict[str, Metric]:
    """Metrics by name; one that cannot be given has the value None and says why.

    Options are those of `fgloc.evaluation.score`, e.g. `score_from_s`. Raises InputError where
    there is no truth.
    """
    if truth is None:
        raise InputError("there is no truth to score against: this drive has none")
    from fgloc.evaluation import score as score_trajectory

    return score_trajectory(estimate, truth, **options)


def compare(
    drives: DriveLike | Iterable[DriveLike],
    methods: Sequence[str | Method] = (),
    *,
    configs: Mapping[str, str | Path | SmoothConfig] | None = None,
    seeds: Iterable[int] | None = None,
    options: Mapping[str, Any] | None = None,
    score_from_s: float = 0.0,
) -> Comparison:
    """Drives through methods: metrics of each, and differences to the first method, paired in time.

    A method is a graph (`graph-batch`, `graph-incremental`, `graph-lag`; with `:velocity` after it
    the same without the IMU), a baseline, or a `Method` of your own. `configs` adds, after them,
    the graph under other configurations by a label of your choice: `{"robust": "robust.toml"}`;
    each says its own mode. `seeds` repeats drives that are scenarios' names, `options` are those of
    all such. A method that fails on a drive is a row that says so. Raises InputError for an
    unknown method, a label that is taken or a faulty configuration before anything is run.
    """
    one = isinstance(drives, Drive | str | Path)
    several: list[DriveLike] = [drives] if one else list(drives)  # type: ignore[list-item, arg-type]
    chosen = [method if isinstance(method, Method) else _method(method) for method in methods]
    chosen += [_configured(label, config) for label, config in (configs or {}).items()]
    made_with = dict(options or {})
    found = compare_methods(_each(several, seeds, made_with), chosen, score_from_s)
    return replace(found, options=made_with)


def _each(
    drives: Sequence[DriveLike], seeds: Iterable[int] | None, options: Mapping[str, Any]
) -> Iterator[tuple[Drive, int | None]]:
    """Drives with the seed each was made with, opened one by one as they are wanted."""
    wanted = None if seeds is None else list(seeds)
    if "seed" in options:
        raise InputError("seed is no option of its own here; give seeds")
    if (wanted is not None or options) and not any(map(is_scenario, drives)):
        raise InputError(
            "seeds and options go with scenarios, and none of the drives is given as one by name"
        )
    for drive in drives:
        named = is_scenario(drive)
        for seed in wanted if wanted is not None and named else (None,):
            yield load(drive, seed=seed, **(options if named else {})), seed


def is_scenario(drive: DriveLike) -> bool:
    """Whether a name stands for a scenario, as `open_drive` would read it."""
    from fgloc.datasets import available
    from fgloc.datasets.drive_folder import is_drive_folder

    names = {info.name for info in available() if info.kind == "scenario"}
    return isinstance(drive, str) and drive in names and not is_drive_folder(drive)


def _method(name: str) -> Method:
    """A method's name with the function that runs it."""
    from fgloc import baselines, smoother

    graphs = smoother.methods()
    if name in graphs:
        config = load_config(**graphs[name])
        return Method(name, lambda drive: smoother.smooth(drive, config))
    baselines.check(name, others=tuple(graphs))
    return Method(name, lambda drive: baselines.run(drive, name))


def _configured(label: str, config: str | Path | SmoothConfig) -> Method:
    """The graph under a configuration, by a label that is no method's name."""
    from fgloc import baselines, smoother

    if not label or label in (*smoother.methods(), *baselines.available()):
        raise InputError(
            f"the label {label!r} of a configuration is a method's name or empty; choose another"
        )
    in_force = configure(config=config)
    return Method(label, lambda drive: smoother.smooth(drive, in_force))
