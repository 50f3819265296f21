"""The command that makes a drive of what a node's cameras and LiDARs recorded."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fgloc.cli import options
from fgloc.cli.options import Command
from fgloc.cli.screen import print_json, say, steps, table

if TYPE_CHECKING:
    from fgloc.drive import Drive
    from fgloc.perception.pipeline import Perceived

OVERLAY = "overlay.png"
_EPILOG = """\b
Examples:
  fgloc perceive recording --out drive
  fgloc perceive recording --detector onnx --onnx yolo.onnx --out drive
  fgloc perceive recording --method camera --set place.point=centre --out drive
A recording is a folder with a recording.toml; see datasets/README.md.
"""


@click.command(cls=Command, epilog=_EPILOG)
@click.argument("recording", metavar="RECORDING", type=click.Path(path_type=Path))
@options.out_drive
@click.option(
    "--method", type=click.Choice(["fused", "lidar", "camera"]),
    help="Which sensors are used; fused, both, if not given.",
)  # fmt: skip
@click.option(
    "--detector", type=click.Choice(["background", "table", "onnx"]),
    help="Boxes in the images: what differs from the fixed background (if not given), the "
    "recording's boxes.csv, or a network.",
)  # fmt: skip
@click.option("--onnx", "network", metavar="FILE", help="The network, for --detector onnx.")
@click.option(
    "--no-overlay", is_flag=True, help=f"Leave {OVERLAY}, a strip of pictures, out of the drive."
)
@options.config
@options.settings("One setting more, e.g. track.coast_s=2")
@options.as_json
def perceive(
    recording: Path, out: Path, overwrite: bool, method: str | None, detector: str | None,
    network: str | None, no_overlay: bool, config: Path | None, settings: tuple[str, ...],
    as_json: bool,
) -> None:  # fmt: skip
    """Turn a node's images and point clouds into detections of road users.

    Boxes in the images, cuboids in the clouds, tracks of each head with an EKF, joined to one list
    with numbers, classes and covariances: a drive folder. What cannot be used is left out and
    counted; clocks and calibration of the sensors are held against each other.
    """
    from fgloc import api
    from fgloc.datasets.drive_folder import check_free, write_drive
    from fgloc.datasets.perception_recording import read_recording
    from fgloc.perception.image_files import write_image
    from fgloc.perception.overlay import Strip

    options.check_settings(settings, method=method, detector=detector)
    overrides = _overrides(method, detector, network)
    check_free(out, overwrite)
    opened = read_recording(recording)
    strip = Strip(opened)
    with steps(f"perceiving {recording}") as tell:

        def show(done: int, of: int, seen: Any) -> None:
            tell(f"frame {done} of {of}, {len(seen.objects)} objects")
            strip.see(done, of, seen)

        drive, found = api.perceive(
            opened, config=config, settings=settings, show=show, **overrides
        )
    write_drive(drive, out, overwrite=overwrite)
    if no_overlay:
        (out / OVERLAY).unlink(missing_ok=True)
    else:
        write_image(out / OVERLAY, strip.image())
    if as_json:
        print_json(_summary(drive, found, out))
    else:
        _print(drive, found, out)


def _overrides(method: str | None, detector: str | None, network: str | None) -> dict[str, Any]:
    """Settings of the options that were given."""
    if network is not None and detector not in (None, "onnx"):
        raise click.UsageError(f"--onnx goes with --detector onnx, not with {detector}")
    onnx = {} if network is None else {"detector": "onnx", "onnx": {"file": network}}
    return {"method": method, "detector": detector, **onnx}


def _summary(drive: "Drive", found: "Perceived", out: Path) -> dict[str, Any]:
    seen = found.detections
    return {
        "drive": drive.name, "folder": str(out), "frames": found.frames, "detections": len(seen),
        "objects": len(set(seen.object_id.tolist())), "dropped": found.dropped,
        "remarks": list(found.remarks), "seconds": found.seconds,
    }  # fmt: skip


def _print(drive: "Drive", found: "Perceived", out: Path) -> None:
    told = _summary(drive, found, out)
    say(
        f"{drive.name}: {told['frames']:,} frames, {told['detections']:,} detections of "
        f"{told['objects']:,} objects"
    )
    if found.dropped:
        rows = [(reason, f"{n:,}") for reason, n in found.dropped.items()]
        table("What was not used", ("what", "how many"), rows)
    for remark in found.remarks:
        say(f"note: {remark}")
    say(f"Drive written to {out}")
