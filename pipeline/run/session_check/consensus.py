"""People who several cameras see together at instants, and how well each camera agrees with them.

A person is a set of bodies, one of each camera at most, whose joints meet in space. In crowds two cameras often agree
on a person who is not there: such a person has few supporters. So the person with most support is taken first, and the
bodies of this person support no other one.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.special import bdtr, bdtrc

from pipeline.calibration.adjustment.parameters import NUM_PARAMETERS, ROTATION, move_camera
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project, projection_matrices
from pipeline.geometry.epipolar import fundamental_matrices
from pipeline.geometry.triangulation import plane_rows, solve_normal
from pipeline.run.session_check.sightings import (
    FAR,
    MIN_JOINTS,
    Points,
    SimultaneousPeople,
    body_distances,
    extents_px,
    ideal_px,
)

# Cameras that see a person, if the session has as many: two alone agree by chance in crowds.
_MIN_VIEWS = 3
# Bodies that are looked at: enough for each camera of a large rig. Fewer instants are looked at in large crowds.
_MAX_BODIES, _MIN_INSTANTS = 1000, 4
# Each camera of a large rig is paired with the cameras at these shares of the rig's size further on.
_STRIDES = (0.04, 0.1, 0.2, 0.3)
# Pairs of bodies that are tried together.
_BATCH = 24
# Turns of a camera about its vertical axis, in degrees, that show how often its people are taken for others.
_WRONG_TURNS_DEG = (-25.0, -15.0, -10.0, -6.0, 6.0, 10.0, 15.0, 25.0)
# Share of the expected people that a camera of a right calibration sees at least, whatever hides people from it, and
# the probability below which chance is no explanation.
_MIN_SEEN, _MAX_CHANCE = 0.35, 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class LocatedPeople:
    """People at instants, by the bodies that agree on them."""

    instant: Int[np.ndarray, " people"]  # Place of each person's instant
    # Pixels of the pictures as the cameras took them; NaN where a camera has no body of the person
    points_px: Float[np.ndarray, "people cameras joints 2"]
    normal: Float[np.ndarray, "people cameras joints 4 4"]  # Each view's part of ``solve_normal``; zeros without a view

    @property
    def is_view(self) -> Bool[np.ndarray, "people cameras"]:
        """True if a camera has a body of a person."""
        return np.isfinite(self.points_px[..., 0]).any(-1)

    def without(
        self, camera: int, min_views: int
    ) -> tuple[Int[np.ndarray, " some"], Float[np.ndarray, "some joints 3"]]:
        """Instants and joints (in the world) of the people that at least so many other cameras see."""
        others = np.delete(np.arange(self.points_px.shape[1]), camera)
        rows = np.flatnonzero(self.is_view[:, others].sum(1) >= min_views)
        return self.instant[rows], solve_normal(self.normal[rows][:, others].sum(1))

    def subset(self, chosen: Bool[np.ndarray, " people"]) -> "LocatedPeople":
        """Select people."""
        return LocatedPeople(self.instant[chosen], self.points_px[chosen], self.normal[chosen])

    def without_views(self, cameras: Sequence[int]) -> Float[np.ndarray, "people cameras joints 2"]:
        """Pixels without the views of some cameras."""
        points_px = self.points_px.copy()
        points_px[:, cameras] = np.nan
        return points_px


@dataclass(frozen=True, slots=True)
class CameraAgreement:
    """How many of a camera's people are where the other cameras locate people."""

    num_agreeing: int  # Number of bodies at the place of a person
    # Number of bodies that could be at the place of a person: people in the picture or bodies, whichever are fewer
    num_compared: int
    chance: float  # Share of bodies at the place of a person if the camera is turned wrong; 0 if none can be compared

    @property
    def contradicts(self) -> bool:
        """True if fewer people agree than any right camera has, however much is hidden from it."""
        share = self.chance + (1.0 - self.chance) * _MIN_SEEN
        return bool(bdtr(self.num_agreeing, self.num_compared, share) < _MAX_CHANCE)

    @property
    def agrees(self) -> bool:
        """True if more people agree than are taken for others by chance, and none are missed for certain."""
        by_chance = bdtrc(self.num_agreeing - 1, self.num_compared, self.chance) if self.num_agreeing else 1.0
        return bool(by_chance < _MAX_CHANCE) and not self.contradicts


def locate_people(cameras: Sequence[Camera], sightings: SimultaneousPeople) -> LocatedPeople:
    """Locate people by all cameras together; those that two cameras alone see come last at each instant."""
    num_cameras, num_joints = len(cameras), len(sightings.joints.names)
    matrices, fundamentals = projection_matrices(cameras), fundamental_matrices(cameras)
    ideal = [ideal_px(camera, own) for camera, own in zip(cameras, sightings.points_px, strict=True)]
    instants, people_px, normals = [np.empty(0, int)], [], []
    for instant in _looked_at(sightings):
        bodies = _bodies_at(matrices, [own[instant] for own in ideal])
        people = list(_people_at(matrices, fundamentals, bodies)) if len(bodies.camera) else []
        points_px = np.full((len(people), num_cameras, num_joints, 2), np.nan)
        normal = np.zeros((len(people), num_cameras, num_joints, 4, 4))
        for number, members in enumerate(people):
            for body in members:
                camera = bodies.camera[body]
                if (own_px := sightings.points_px[camera][instant]) is not None:
                    points_px[number, camera] = own_px[bodies.row[body]]
                normal[number, camera] = bodies.normal[body]
        instants.append(np.full(len(people), instant))
        people_px.append(points_px)
        normals.append(normal)
    return LocatedPeople(np.concatenate(instants), np.concatenate(people_px), np.concatenate(normals))


def measure_agreement(
    camera: Camera, number: int, sightings: SimultaneousPeople, located: LocatedPeople
) -> CameraAgreement:
    """Compare the people of a camera with the people located by the other cameras.

    ``number`` is the position of the camera. People who three other cameras see count, if there are enough of them.
    """
    own = sightings.points_px[number]
    agreement = CameraAgreement(0, 0, 0.0)
    for min_views in (_MIN_VIEWS, 2):
        instants, people_m = located.without(number, min_views)
        num_agreeing, num_compared = _compare(camera, instants, people_m, own)
        if num_compared <= agreement.num_compared:
            continue
        wrong = [_compare(_panned(camera, turn), instants, people_m, own) for turn in _WRONG_TURNS_DEG]
        by_chance, possible = np.sum(wrong, axis=0)
        agreement = CameraAgreement(num_agreeing, num_compared, float(by_chance) / max(int(possible), 1))
        if agreement.agrees or agreement.contradicts:
            break
    return agreement


def _looked_at(sightings: SimultaneousPeople) -> list[int]:
    num_bodies = sum(sightings.num_people(number) for number in range(len(sightings.points_px)))
    num_instants = len(sightings.time_s)
    kept = min(num_instants, max(_MIN_INSTANTS, int(num_instants * _MAX_BODIES / max(num_bodies, 1))))
    return [num_instants * place // kept for place in range(kept)]


@dataclass(frozen=True, slots=True, eq=False)
class _Bodies:
    """Bodies of all cameras at an instant, in the order of the cameras."""

    camera: Int[np.ndarray, " bodies"]
    row: Int[np.ndarray, " bodies"]  # Row among the bodies of the camera
    points_px: Float[np.ndarray, "bodies joints 2"]  # Undistorted
    extent_px: Float[np.ndarray, " bodies"]
    normal: Float[np.ndarray, "bodies joints 4 4"]


def _bodies_at(matrices: Float[np.ndarray, "cameras 3 4"], people: Sequence[Points | None]) -> _Bodies:
    seen = [(number, own) for number, own in enumerate(people) if own is not None and len(own)]
    if not seen:
        return _Bodies(*(np.empty(0, int),) * 2, np.empty((0, 0, 2)), np.empty(0), np.empty((0, 0, 4, 4)))
    camera = np.concatenate([np.full(len(own), number) for number, own in seen])
    points_px = np.concatenate([own for _, own in seen])
    parts = [plane_rows(matrices[number][None], own[:, None])[:, 0] for number, own in seen]
    rows = np.nan_to_num(np.concatenate(parts))
    row = np.concatenate([np.arange(len(own)) for _, own in seen])
    return _Bodies(camera, row, points_px, extents_px(points_px), rows.swapaxes(-1, -2) @ rows)


def _people_at(
    matrices: Float[np.ndarray, "cameras 3 4"], fundamentals: Float[np.ndarray, "cameras cameras 3 3"], bodies: _Bodies
) -> Iterator[Int[np.ndarray, " members"]]:
    """Bodies of each person, who has most support among the bodies that are left."""
    pairs = _near_pairs(fundamentals, bodies)
    is_free = np.ones(len(bodies.camera), bool)
    tried = np.empty((0, 2), int)
    while len(pairs):
        support, members = _supported(matrices, bodies, is_free, pairs[:_BATCH])
        best = int(np.argmax(support))
        person = members[best][members[best] >= 0]
        if len(person) < _MIN_VIEWS:
            tried, pairs = np.concatenate([tried, pairs[:_BATCH]]), pairs[_BATCH:]
            continue
        _, again = _supported(matrices, bodies, is_free, person[None])
        person = again[0][again[0] >= 0] if np.count_nonzero(again[0] >= 0) >= _MIN_VIEWS else person
        yield person
        is_free[person] = False
        pairs = pairs[is_free[pairs].all(1)]
    for pair in tried:
        if is_free[pair].all():
            yield pair
            is_free[pair] = False


def _near_pairs(fundamentals: Float[np.ndarray, "cameras cameras 3 3"], bodies: _Bodies) -> Int[np.ndarray, "pairs 2"]:
    """Pairs of bodies that may be one person, the nearest first."""
    seeing, starts = np.unique(bodies.camera, return_index=True)
    place = {
        int(number): slice(start, end) for number, start, end in zip(seeing, starts, [*starts[1:], None], strict=True)
    }
    number = len(seeing)
    partners = set(itertools.combinations(range(number), 2))
    if number > 2 * len(_STRIDES) + 1:
        strides = [max(1, round(number * share)) for share in _STRIDES]
        further = [(k, (k + stride) % number) for k in range(number) for stride in strides]
        partners = {(min(pair), max(pair)) for pair in further}
    pairs, distances = [np.empty((0, 2), int)], [np.empty(0)]
    for left, right in sorted(partners):
        first, second = int(seeing[left]), int(seeing[right])
        own, other = place[first], place[second]
        distance = body_distances(fundamentals[first, second], bodies.points_px[own], bodies.points_px[other])
        near = np.argwhere(distance < FAR)
        pairs.append(near + np.array([own.start, other.start]))
        distances.append(distance[tuple(near.T)])
    return np.concatenate(pairs)[np.argsort(np.concatenate(distances), kind="stable")]


def _supported(
    matrices: Float[np.ndarray, "cameras 3 4"],
    bodies: _Bodies,
    is_free: Bool[np.ndarray, " bodies"],
    sets: Int[np.ndarray, "sets members"],
) -> tuple[Float[np.ndarray, " sets"], Int[np.ndarray, "sets seeing"]]:
    """Support of the persons in which sets of bodies meet, and the nearest body of each camera; -1 for none."""
    poses_m = solve_normal(bodies.normal[sets].sum(1))
    free = np.flatnonzero(is_free)
    seeing, starts = np.unique(bodies.camera[free], return_index=True)
    homogeneous = np.concatenate([poses_m, np.ones_like(poses_m[..., :1])], axis=-1)
    projected = homogeneous @ matrices[seeing][:, None].swapaxes(-1, -2)
    with np.errstate(invalid="ignore", divide="ignore"):
        projected_px = np.where(projected[..., 2:] > 0.0, projected[..., :2] / projected[..., 2:], np.nan)
    support, members = np.zeros(len(sets)), np.full((len(sets), len(seeing)), -1)
    for number, (start, end) in enumerate(zip(starts, [*starts[1:], len(free)], strict=True)):
        own = free[start:end]
        away = _away(projected_px[number][:, None], bodies.points_px[own], bodies.extent_px[own])
        nearest = np.argmin(away, axis=1)
        distance = away[np.arange(len(sets)), nearest]
        is_near = distance < FAR
        members[is_near, number] = own[nearest[is_near]]
        support += np.where(is_near, 1.0 - (distance / FAR) ** 2, 0.0)
    return support, members


def _away(
    places_px: Float[np.ndarray, "*#batch joints 2"], points_px: Points, extent_px: Float[np.ndarray, " bodies"]
) -> Float[np.ndarray, "*batch bodies"]:
    """Median distance of bodies from places as a share of the bodies' extent; infinite with too few common joints."""
    away = np.hypot(places_px[..., 0] - points_px[..., 0], places_px[..., 1] - points_px[..., 1])
    # The median of the known joints: unknown ones are sorted to the end.
    ordered = np.sort(away, axis=-1)
    count = np.isfinite(away).sum(-1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    return np.where(count >= MIN_JOINTS, middle / extent_px, np.inf)


def _panned(camera: Camera, turn_deg: float) -> Camera:
    """Turn a camera about its vertical axis."""
    step = np.zeros(NUM_PARAMETERS)
    step[ROTATION] = [0.0, np.radians(turn_deg), 0.0]
    return move_camera(camera, step)


def _compare(
    camera: Camera,
    instants: Int[np.ndarray, " people"],
    people_m: Float[np.ndarray, "people joints 3"],
    own: Sequence[Points | None],
) -> tuple[int, int]:
    """Number of a camera's bodies at the place of a person in its picture, and number that could be."""
    places_px = project(camera, people_m)
    is_inside = np.asarray(((places_px >= 0.0) & (places_px <= np.array(camera.size_px) - 1.0)).all(-1))
    places_px = np.where(is_inside[..., None], places_px, np.nan)
    is_visible = is_inside.sum(-1) >= MIN_JOINTS
    num_agreeing = num_compared = 0
    for instant in np.unique(instants[is_visible]):
        bodies_px = own[instant]
        if bodies_px is None or not len(bodies_px):
            continue
        places = places_px[(instants == instant) & is_visible]
        away = np.minimum(_away(places[:, None], bodies_px, extents_px(bodies_px)), FAR)
        rows, columns = linear_sum_assignment(away)
        num_agreeing += int(np.count_nonzero(away[rows, columns] < FAR))
        num_compared += len(rows)
    return num_agreeing, num_compared
