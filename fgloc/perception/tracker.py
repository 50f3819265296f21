"""Tracks of one head: which measurement is of which track, births, deaths, classes.

After Lee et al. (2021), section III-B. A LiDAR's cuboids go to the tracks by their distance in
sigmas; then the cuboids of all tracks are projected into each image and go to its boxes by IoU,
both as the best set of pairs (Hungarian method). The class comes from the boxes.

- birth: a cuboid, or a box with a place on the ground, that no track explains and that is no part
  of one. Boxes of two cameras of one head meet in the track: the first begins it, the second is
  matched to it.
- told of from `confirm_hits` frames of its first `confirm_frames` on; without them it dies
- coasts by its velocity while it is not seen, for at most `coast_s`
- an object that only one sensor sees is a track like others, with a class only if a camera does or
  its size leaves no doubt
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from fgloc.chi_square import chi2_quantile
from fgloc.measurements import PEDESTRIAN, UNKNOWN, VEHICLE, Array
from fgloc.perception.boxes import Cuboids, ImageBoxes
from fgloc.perception.ground import Placing, on_border
from fgloc.perception.heads import Camera, Lidar
from fgloc.perception.iou import Pairs, best_pairs, image_iou
from fgloc.perception.settings import PerceiveConfig
from fgloc.perception.track_filter import (
    S_,
    Belief,
    Measured,
    along_course,
    born_of_cuboids,
    born_of_sightings,
    by_box,
    by_cuboid,
    by_kind,
    by_sighting,
    forget_place,
    predict,
    update,
    was_assumed,
)
from fgloc.perception.tracks import Rows, Tracks, is_inside, project, share_inside
from fgloc.timing import NS_PER_S

CAR_FROM_M, PERSON_TO_M, PERSON_FROM_M = 2.5, 1.0, 1.2
"""What is longer is a vehicle; what is shorter and higher than that, a pedestrian."""
SURE_POINTS = 15
"""A small cuboid of fewer points may be a part of anything."""
PART_SHARE = 0.5
"""A box with more than this share inside of a track's is a part of it."""
PART_M = 0.5
"""A cuboid whose centre is so near to a track's plan is a part of it."""
BOX_SIGMA_PX, SHAPE_SIGMA_M = 2.0, 0.3
"""How far the middles of a box and of a cuboid's image differ, in the image and on the object."""
_SIZE_OPEN_M = 1.5
_KNOWN_M = 100.0
_BLINK_S = 0.01


class Match(NamedTuple):
    """A box that went to a track which the LiDAR saw in the same frame: where the cuboid is in the
    image (2,) px by the LiDAR, where the box is, how fast the cuboid moves there, px/s, and how far
    both may differ as a cuboid is no car."""

    camera: int
    expected_px: Array
    seen_px: Array
    speed_pxps: Array
    sigma_px: float


class Tracker:
    """Tracks of one head. A frame is `begin`, what was measured in the order of time, `end`.

    cameras  by their numbers among the node's; places likewise, none where boxes give classes only
    lidar    None where the head has none
    matches  pairs for the check of clocks and calibration, so far; doubtful counts the tracks that
             died without being confirmed
    """

    def __init__(
        self, cameras: Mapping[int, Camera], places: Mapping[int, Placing], lidar: Lidar | None,
        ground_m: float, settings: PerceiveConfig,
    ) -> None:  # fmt: skip
        self.cameras, self.places, self.lidar = cameras, places, lidar
        self.ground_m, self.config, self.place = ground_m, settings.track, settings.place
        self.tracks = Tracks.none()
        self.matches: list[Match] = []
        self.doubtful = 0
        self._gate = chi2_quantile(self.config.gate_probability, 2)
        self._box_gate = chi2_quantile(self.config.gate_probability, 5)
        self._now_ns = self._begun_ns = 0
        self._born = 0

    def begin(self, t_ns: int) -> None:
        """A new frame: what is measured from now on is kept apart from what was before."""
        self.advance(t_ns)
        self.tracks.alone = forget_place(self.tracks.belief)
        self._begun_ns = t_ns

    def advance(self, t_ns: int) -> None:
        """All tracks to an instant, which must not lie before the last one."""
        dt_s, self._now_ns = (t_ns - self._now_ns) / NS_PER_S, t_ns
        if dt_s > 0 and len(self.tracks):
            kind = self.tracks.kind
            self.tracks.belief = predict(self.tracks.belief, dt_s, kind, self.config)
            self.tracks.alone = predict(self.tracks.alone, dt_s, kind, self.config)

    def see_cuboids(self, t_ns: int, cuboids: Cuboids) -> None:
        """A LiDAR's cuboids at an instant, in the node's axes."""
        self.advance(t_ns)
        pairs = self._pairs_of_cuboids(cuboids)
        self._hit(pairs[:, 0])
        seen = cuboids.take(pairs[:, 1])
        self._update(pairs[:, 0], lambda belief: self._cuboid(belief, seen))
        self._name_by_size(pairs[:, 0], seen)
        free = np.setdiff1d(np.arange(len(cuboids)), pairs[:, 1])
        part = is_inside(cuboids.centre_m[free, :2], self.tracks.belief, PART_M).any(1)
        new = cuboids.take(free[~part])
        rows = self._bear(born_of_cuboids(new, self.ground_m, self.config))
        self._name_by_size(rows, new)

    def see_boxes(self, t_ns: int, number: int, boxes: ImageBoxes) -> None:
        """Boxes in an image of a camera of the head, given by its number, at an instant."""
        self.advance(t_ns)
        cuboid_px = project(self.cameras[number], self.tracks.belief)
        iou = image_iou(cuboid_px, boxes.box_px)
        pairs = best_pairs(iou, iou > self.config.least_iou)
        self._hit(pairs[:, 0])
        # What the edge of the image cuts off has no class and no place.
        whole = ~on_border(self.cameras[number], boxes.box_px)
        full = pairs[whole[pairs[:, 1]]]
        matched = boxes.take(full[:, 1])
        self._note(number, matched, full[:, 0])
        self._vote(full[:, 0], matched.kind)
        self._place(number, matched, full[:, 0])
        free = np.setdiff1d(np.flatnonzero(whole), pairs[:, 1])
        inside = share_inside(boxes.box_px[free], cuboid_px).max(1, initial=0.0)
        self._bear_boxes(number, boxes.take(free[inside < PART_SHARE]))

    def end(self) -> Tracks:
        """Close the frame: the confirmed tracks that it saw. What is lost or doubtful dies."""
        tracks, c = self.tracks, self.config
        seen = tracks.seen_ns >= self._begun_ns
        tracks.hits += seen
        tracks.frames += 1
        tracks.belief = along_course(tracks.belief, tracks.kind, c)
        confirmed = tracks.hits >= c.confirm_hits
        lost = self._now_ns - tracks.seen_ns > c.coast_s * NS_PER_S
        doubtful = ~confirmed & (tracks.frames >= c.confirm_frames)
        self.doubtful += int((~confirmed & (lost | doubtful)).sum())
        self.tracks = tracks.take(~lost & ~doubtful)
        placed = tracks.alone_P[:, 0, 0] < _KNOWN_M**2
        return tracks.take(seen & confirmed & placed)

    def _update(self, rows: Rows, measure: Callable[[Belief], Measured]) -> None:
        """Some tracks, each at most once, by what `measure` makes of their states."""
        if len(rows):
            t = self.tracks
            for x, P in ((t.x, t.P), (t.alone_x, t.alone_P)):
                some = Belief(x[rows], P[rows])
                x[rows], P[rows] = update(some, measure(some))

    def _hit(self, rows: Rows) -> None:
        self.tracks.seen_ns[rows] = self._now_ns

    def _cuboid(self, belief: Belief, seen: Cuboids) -> Measured:
        assert self.lidar is not None  # or there are no cuboids
        return by_cuboid(belief, seen, self.lidar.p_node_lidar_m, self.ground_m, self.config)

    def _pairs_of_cuboids(self, cuboids: Cuboids) -> Pairs:
        """By the distance of their near sides, in sigmas."""
        T, N = len(self.tracks), len(cuboids)
        if not T or not N:
            return best_pairs(np.zeros((T, N)), np.zeros((T, N), bool))
        row, column = (index.ravel() for index in np.indices((T, N)))
        belief = self.tracks.belief.at(row)
        near = self._cuboid(belief, cuboids.take(column))
        near = Measured(near.error[:, :2], near.H[:, :2], near.R[:, :2, :2])
        nis = near.nis(belief).reshape(T, N)
        return best_pairs(-nis, nis < self._gate)

    def _name_by_size(self, rows: Rows, seen: Cuboids) -> None:
        """A class for tracks that have none, where the cuboid's size leaves no doubt."""
        long, high = seen.size_m[:, :2].max(-1), seen.size_m[:, 2]
        person = (long < PERSON_TO_M) & (high > PERSON_FROM_M) & (seen.points >= SURE_POINTS)
        car = ((seen.size_m > CAR_FROM_M) & ~was_assumed(seen.size_m))[:, :2].any(-1)
        kind = np.where(car, VEHICLE, np.where(person, PEDESTRIAN, UNKNOWN))
        new = (self.tracks.kind[rows] == UNKNOWN) & (kind != UNKNOWN)
        self._name(rows[new], kind[new])

    def _vote(self, rows: Rows, kind: Rows) -> None:
        """Classes of boxes; a track has that which most of its boxes said."""
        self.tracks.votes[rows, kind] += 1
        most = self.tracks.votes[rows].argmax(1)
        new = (most != UNKNOWN) & (most != self.tracks.kind[rows])
        self._name(rows[new], most[new])

    def _name(self, rows: Rows, kind: Rows) -> None:
        """A class that is new for some tracks, with the size to expect of it."""
        t = self.tracks
        again = rows[t.kind[rows] != UNKNOWN]
        t.kind[rows] = kind
        for P in (t.P, t.alone_P):
            P[again, S_, :], P[again, :, S_] = 0, 0
            P[again[:, None], [5, 6, 7], [5, 6, 7]] = _SIZE_OPEN_M**2
        self._update(rows, lambda belief: by_kind(belief, kind))

    def _note(self, number: int, boxes: ImageBoxes, rows: Rows) -> None:
        """Keep what tells of clocks and calibration."""
        by_lidar = self.tracks.alone_P[rows, 0, 0] < _KNOWN_M**2
        rows, box_px = rows[by_lidar], boxes.box_px[by_lidar]
        camera, here = self.cameras[number], self.tracks.alone.at(rows)
        later = here.x.copy()
        later[:, :2] += _BLINK_S * self.tracks.x[rows, 3:5]
        at_px, then_px = (_middle(project(camera, Belief(x, here.P))) for x in (here.x, later))
        speed = (then_px - at_px) / _BLINK_S
        known = np.isfinite(at_px + then_px).all(1)
        far_m = np.linalg.norm(here.x[:, :3] - camera.p_node_cam_m, axis=1)
        sigma_px = BOX_SIGMA_PX + SHAPE_SIGMA_M * camera.focal_px.max() / far_m
        seen_px = _middle(box_px)
        self.matches += [
            Match(number, at_px[k], seen_px[k], speed[k], float(sigma_px[k]))
            for k in np.flatnonzero(known).tolist()
        ]

    def _place(self, number: int, boxes: ImageBoxes, rows: Rows) -> None:
        """What matched boxes say of places and sizes, where it is known and fits."""
        if number not in self.places or not len(rows):
            return
        camera = self.cameras[number]
        if self.place.point == "edges":
            belief = self.tracks.belief.at(rows)
            nis = by_box(belief, boxes.box_px, camera, self.ground_m, self.place).nis(belief)
            near = np.flatnonzero(nis < self._box_gate)
            fits = boxes.box_px[near]
            self._update(
                rows[near], lambda some: by_box(some, fits, camera, self.ground_m, self.place)
            )
            return
        seen = self.places[number].sight(boxes.box_px, self.tracks.kind[rows])
        rows, seen = rows[seen.known], seen.take(np.flatnonzero(seen.known))
        belief = self.tracks.belief.at(rows)
        at_m = camera.p_node_cam_m
        near = np.flatnonzero(by_sighting(belief, seen, at_m).nis(belief) < self._gate)
        known = seen.take(near)
        self._update(rows[near], lambda belief: by_sighting(belief, known, at_m))

    def _bear_boxes(self, number: int, boxes: ImageBoxes) -> None:
        """Tracks of boxes alone."""
        if number not in self.places or not self.config.camera_only:
            return
        seen = self.places[number].sight(boxes.box_px, boxes.kind)
        known = np.flatnonzero(seen.known)
        seen, kind = seen.take(known), boxes.kind[known]
        at_m = self.cameras[number].p_node_cam_m
        rows = self._bear(born_of_sightings(seen, kind, at_m, self.ground_m, self.config))
        self.tracks.votes[rows, kind] += 1
        self.tracks.kind[rows] = kind

    def _bear(self, belief: Belief) -> Rows:
        """Add tracks; their rows."""
        first = len(self.tracks)
        self.tracks = self.tracks.and_(Tracks.born(belief, self._born, self._now_ns))
        self._born += len(belief.x)
        return np.arange(first, len(self.tracks))


def _middle(box_px: Array) -> Array:
    return np.asarray((box_px[:, :2] + box_px[:, 2:]) / 2)
