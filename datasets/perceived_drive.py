"""What a node's perception needs from files, and what it gives as a drive."""

from dataclasses import replace
from pathlib import Path

from fgloc.datasets.calibration_set import read_calibration
from fgloc.datasets.recording import left_out
from fgloc.drive import Drive, Rig
from fgloc.infrastructure import Infrastructure
from fgloc.perception.ground import ByMap
from fgloc.perception.idw import IdwMap
from fgloc.perception.map_error import ErrorMap
from fgloc.perception.pipeline import Perceived
from fgloc.perception.recording import Recording


def map_of(recording: Recording, path: str | Path) -> ByMap:
    """The map from boxes to the ground by a calibration set; DriveError where the file is faulty,
    InputError where its places leave no map."""
    calibration = read_calibration(path)
    return ByMap(
        recording.node.node, IdwMap(calibration), ErrorMap.of(IdwMap, calibration)
    )  # fmt: skip


def drive_of(recording: Recording, perceived: Perceived) -> Drive:
    """A drive of the node's detections alone, with the truth of the road users where it is known;
    its description says what was not used."""
    about = recording.about
    source = "; ".join(filter(None, (about.source, "fgloc perceive", left_out(perceived.dropped))))
    return Drive(
        recording.name, recording.origin, Rig(), {"detections": perceived.detections},
        about=replace(about, source=source), infrastructure=Infrastructure((recording.node.node,)),
        objects=recording.objects,
    )  # fmt: skip
