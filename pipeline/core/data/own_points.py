"""Points of the user's own: points of keypoint files that are no joints of ours, in pictures and in the world."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet


class RigidShape(NamedTuple):
    """Rigid object: its points, and their places in the axes of the object."""

    name: str
    points: tuple[str, ...]
    xyz_m: Float[np.ndarray, "points 3"]
    has_sides: bool = True  # False: from distances, which its mirror image has as well


@dataclass(frozen=True, slots=True, eq=False)
class OwnDetections:
    """Own points in the pictures of a session; arrays of ``Detections`` have own points in place of joints."""

    names: tuple[str, ...] = ()  # Names of the points, in the order of the arrays
    of_bodies: Mapping[str, Detections] = field(default_factory=dict)  # By camera; the rows of the session's bodies
    of_scene: Mapping[str, Detections] = field(default_factory=dict)  # By camera; a row a frame, points without a body
    # By camera; rows of bodies that are no people's, whose points are all own points: animals
    of_animals: Mapping[str, Detections] = field(default_factory=dict)
    shapes: tuple[RigidShape, ...] = field(default=(), kw_only=True)
    bones: tuple[tuple[str, str], ...] = field(default=(), kw_only=True)  # Pairs of points between which bones are

    def within(self, frames: Mapping[str, range]) -> "OwnDetections":
        """Select ranges of the cameras' frame numbers."""
        bodies, scene, animals = (
            {camera: detections.within(frames[camera]) for camera, detections in some.items()} for some in self.kinds
        )
        return replace(self, of_bodies=bodies, of_scene=scene, of_animals=animals)

    @property
    def kinds(self) -> tuple[Mapping[str, Detections], ...]:
        """Points by what they are listed with."""
        return self.of_bodies, self.of_scene, self.of_animals


class SceneObject(NamedTuple):
    """Object that belongs to no person."""

    name: str
    points: tuple[str, ...]  # Names of its points: of a single point the object's name
    track: Track3D  # Its points over all frames of the take, in place of joints
    bones: tuple[tuple[str, str], ...] = ()  # Pairs of its points


@dataclass(frozen=True, slots=True, eq=False)
class OwnTracks:
    """Own points in the world."""

    names: tuple[str, ...] = ()  # Names of people's points, in the order of the arrays
    of_people: tuple[Track3D, ...] = ()  # Points of each person in the frames of the person's track; none without names
    objects: tuple[SceneObject, ...] = ()
    shapes: tuple[RigidShape, ...] = ()  # Rigid objects with poses, see ``association.own_points.rigid``
    doubts: tuple[str, ...] = ()  # Sentences, such as about rigid objects without a pose in any frame
    bones: tuple[tuple[str, str], ...] = ()  # Pairs of people's points

    def of_person(self, number: int) -> Track3D | None:
        """Points of the person with a number on the list of tracks; ``None`` without any."""
        return self.of_people[number] if self.names else None

    @property
    def scene(self) -> tuple[JointSet, Track3D] | None:
        """Points of all objects like joints of a person, with their names; ``None`` without objects."""
        if not self.objects:
            return None
        names = tuple(name for thing in self.objects for name in thing.points)
        first, *others = (thing.track for thing in self.objects)
        return JointSet(names, tuple(bone for thing in self.objects for bone in thing.bones)), joined(first, *others)


def columns_of(points: Track3D, columns: list[int]) -> Track3D:
    """Track with some of its points."""
    arrays: dict[str, Any] = {name: read_only(array[:, columns]) for name, array in points.joint_arrays.items()}
    return replace(points, **arrays)


def joined(track: Track3D, *others: Track3D) -> Track3D:
    """Track with the points of others, in the same frames, behind its own."""
    unknown = {"uncertainty_m": np.full(track.score.shape, np.nan)} | track.joint_arrays
    arrays: dict[str, Any] = {
        name: read_only(np.concatenate([array, *(other.joint_arrays[name] for other in others)], axis=1))
        for name, array in unknown.items()
    }
    return replace(track, **arrays)
