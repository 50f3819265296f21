"""GPX and KML: valid XML with the places, heights and times of the trajectory."""

from xml.etree import ElementTree

import pytest

from fgloc.datasets.map_files import write_gpx, write_kml, write_map
from fgloc.errors import InputError
from fgloc.frames import Origin
from fgloc.trajectory import Trajectory

ORIGIN = Origin(40.0, -105.0, 1600.0)
PATH = Trajectory([10**18, 10**18 + 500_000_000], [[0, 0, 0], [0, 111.0, 1.0]])
GPX = {"g": "http://www.topografix.com/GPX/1/1"}
KML = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}


def test_gpx_holds_a_point_with_height_and_utc_for_each_state(tmp_path):
    path = tmp_path / "t.gpx"
    write_gpx(path, PATH, ORIGIN, name="a <drive> & more")
    root = ElementTree.parse(path).getroot()
    assert (root.tag, root.get("version")) == ("{http://www.topografix.com/GPX/1/1}gpx", "1.1")
    assert root.findtext("g:trk/g:name", None, GPX) == "a <drive> & more"
    points = root.findall("g:trk/g:trkseg/g:trkpt", GPX)
    assert [p.findtext("g:time", None, GPX) for p in points] == [
        "2001-09-09T01:46:40.000Z", "2001-09-09T01:46:40.500Z",
    ]  # fmt: skip
    assert (float(points[0].get("lat")), float(points[0].get("lon"))) == (40.0, -105.0)
    assert float(points[1].get("lat")) == pytest.approx(40.001, abs=1e-5)
    assert float(points[1].findtext("g:ele", None, GPX)) == pytest.approx(1601.0, abs=0.01)


def test_kml_holds_as_many_times_as_places(tmp_path):
    path = tmp_path / "t.kml"
    write_kml(path, PATH, ORIGIN, name="drive")
    root = ElementTree.parse(path).getroot()
    assert root.tag == "{http://www.opengis.net/kml/2.2}kml"
    track = root.find("k:Document/k:Placemark/gx:Track", KML)
    assert track.findtext("k:altitudeMode", None, KML) == "absolute"
    assert [when.text for when in track.findall("k:when", KML)][1] == "2001-09-09T01:46:40.500Z"
    places = [coord.text for coord in track.findall("gx:coord", KML)]
    assert places[0] == "-105.000000000 40.000000000 1600.0000" and len(places) == 2


@pytest.mark.parametrize(("datum", "says"), [("ellipsoid", "ellipsoid"), ("msl", "mean sea level")])
@pytest.mark.parametrize("suffix", ["gpx", "kml"])
def test_the_files_say_what_heights_are_above(tmp_path, suffix, datum, says):
    write_map(tmp_path / f"t.{suffix}", PATH, Origin(40.0, -105.0, 0.0, datum), name="drive")
    assert "Heights are above" in (text := (tmp_path / f"t.{suffix}").read_text()) and says in text


@pytest.mark.parametrize("write", [write_gpx, write_kml])
def test_a_trajectory_without_states_makes_no_track(tmp_path, write):
    with pytest.raises(InputError, match="'empty' has no states"):
        write(tmp_path / "t", PATH.take(slice(0, 0)), ORIGIN, name="empty")
