"""Trajectories for map programs: GPX 1.1 and KML 2.2, with altitude and a UTC time at each state.

Both formats think of altitudes above mean sea level. Ours are above the drive's datum, which the
files name; nothing is converted, that would take a model of the geoid.
"""

from pathlib import Path
from xml.etree import ElementTree

from fgloc.errors import InputError
from fgloc.frames import Origin
from fgloc.timing import iso_utc
from fgloc.trajectory import Trajectory

_GPX = "http://www.topografix.com/GPX/1/1"
_KML = "http://www.opengis.net/kml/2.2"
_KML_TRACK = "http://www.google.com/kml/ext/2.2"  # KML 2.2 itself has no times along a line
_DATUMS = {"ellipsoid": "the WGS84 ellipsoid", "msl": "mean sea level"}

Points = list[tuple[str, str, str, str]]
"""Latitude and longitude in degrees to 0.1 mm, height in m, ISO time, all as text."""


def write_gpx(path: str | Path, trajectory: Trajectory, origin: Origin, *, name: str) -> None:
    """Write a track with one segment; InputError for a trajectory without states."""
    gpx = ElementTree.Element("gpx", {"xmlns": _GPX, "version": "1.1", "creator": "fgloc"})
    track = ElementTree.SubElement(gpx, "trk")
    ElementTree.SubElement(track, "name").text = name
    ElementTree.SubElement(track, "desc").text = _about_height(origin)
    segment = ElementTree.SubElement(track, "trkseg")
    for lat, lon, height, time in _points(trajectory, origin, name):
        point = ElementTree.SubElement(segment, "trkpt", {"lat": lat, "lon": lon})
        ElementTree.SubElement(point, "ele").text = height
        ElementTree.SubElement(point, "time").text = time
    _write(path, gpx)


def write_kml(path: str | Path, trajectory: Trajectory, origin: Origin, *, name: str) -> None:
    """Write a placemark with a timed track (gx:Track); InputError without states."""
    kml = ElementTree.Element("kml", {"xmlns": _KML, "xmlns:gx": _KML_TRACK})
    placemark = ElementTree.SubElement(ElementTree.SubElement(kml, "Document"), "Placemark")
    ElementTree.SubElement(placemark, "name").text = name
    ElementTree.SubElement(placemark, "description").text = _about_height(origin)
    track = ElementTree.SubElement(placemark, "gx:Track")
    ElementTree.SubElement(track, "altitudeMode").text = "absolute"
    points = _points(trajectory, origin, name)
    for *_, time in points:
        ElementTree.SubElement(track, "when").text = time
    for lat, lon, height, _ in points:
        ElementTree.SubElement(track, "gx:coord").text = f"{lon} {lat} {height}"
    _write(path, kml)


def write_map(path: Path, trajectory: Trajectory, origin: Origin, *, name: str) -> None:
    """Write the format that the suffix names, gpx or kml."""
    {".gpx": write_gpx, ".kml": write_kml}[path.suffix](path, trajectory, origin, name=name)


def _points(trajectory: Trajectory, origin: Origin, name: str) -> Points:
    if not len(trajectory):
        raise InputError(f"trajectory {name!r} has no states, so there is no track to write")
    lat, lon, height = origin.to_geodetic(trajectory.p_world_m).T
    lon = (lon + 180) % 360 - 180
    columns = zip(lat.tolist(), lon.tolist(), height.tolist(), strict=True)
    times = map(iso_utc, trajectory.t_ns.tolist())
    return [
        (f"{a:.9f}", f"{b:.9f}", f"{h:.4f}", time)
        for (a, b, h), time in zip(columns, times, strict=True)
    ]


def _about_height(origin: Origin) -> str:
    return f"Heights are above {_DATUMS[origin.datum]}."


def _write(path: str | Path, root: ElementTree.Element) -> None:
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
