"""Likenesses among the people of a take: who never moves, and who is another person's mirror image."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from pipeline.association.identity.likenesses.mirrored import Mirror, MirrorImage, find_mirror, is_image
from pipeline.association.identity.likenesses.still import StillPerson, find_still
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.joints import JointSet
from pipeline.geometry.camera import center_in_world

Sees = Callable[[int], Bool[np.ndarray, "frames cameras"]]
"""Returns the frames in which each camera saw a person, by the position of the track."""


@dataclass(frozen=True, slots=True)
class Likenesses:
    """People of a take who may be none."""

    still: Sequence[StillPerson] = ()  # Those who never move
    images: Sequence[MirrorImage] = ()  # Mirror images of others

    @property
    def numbers(self) -> frozenset[int]:
        """Positions of their tracks."""
        return frozenset([*(person.number for person in self.still), *(image.number for image in self.images)])

    def others(self, num_people: int) -> Sequence[int]:
        """Positions of the tracks of all others, by whom floor and cameras are judged; everybody's without any."""
        return [number for number in range(num_people) if number not in self.numbers] or list(range(num_people))


def find_likenesses(
    tracks: Sequence[Track3D],
    sees: Sees,
    cameras: Sequence[Camera],
    joints: JointSet,
    frame_rate_hz: float,
) -> Likenesses:
    """Find who never moves, and who is another person's mirror image.

    Tracks are as association located them. The mirror image of somebody who never moves is another one who never moves.
    """
    kept = list(tracks)
    found = (find_still(number, track, joints, frame_rate_hz) for number, track in enumerate(kept))
    still = [person for person in found if person is not None]
    moving = [number for number in range(len(kept)) if number not in {person.number for person in still}]
    cameras_m = np.array([center_in_world(camera) for camera in cameras])
    images: dict[int, MirrorImage] = {}
    for place, first in enumerate(moving):
        for second in moving[place + 1 :]:
            mirror = find_mirror(kept[first], kept[second], joints, frame_rate_hz)
            if mirror is None:
                continue
            for image, original, plane in (
                (second, first, mirror),
                (first, second, Mirror(-mirror.normal, -mirror.offset_m, mirror.error_m)),
            ):
                num_common = _num_common(kept[first], kept[second])
                if is_image(plane, kept[image], cameras_m, sees(image), num_common):
                    sign = float(np.sign(plane.normal[np.argmax(np.abs(plane.normal))]))
                    normal, offset_m = read_only(sign * plane.normal), sign * plane.offset_m
                    candidate = MirrorImage(image, original, normal, offset_m, plane.error_m, num_common)
                    if image not in images or candidate.num_frames > images[image].num_frames:
                        images[image] = candidate
    return Likenesses(still, [images[number] for number in sorted(images)])


def seen_in(observations: Sequence[Observations]) -> Sees:
    """Frames in which each camera saw any joint of a person."""
    return lambda number: np.asarray((observations[number].score > 0.0).any(-1))


def _num_common(first: Track3D, second: Track3D) -> int:
    """Number of frames in which both people were located."""
    start = max(first.start_frame, second.start_frame)
    stop = min(first.start_frame + first.num_frames, second.start_frame + second.num_frames)
    located = [
        np.isfinite(track.xyz_m[start - track.start_frame : stop - track.start_frame, :, 0]).any(-1)
        for track in (first, second)
    ]
    return int(np.count_nonzero(located[0] & located[1]))
