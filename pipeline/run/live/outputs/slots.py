"""Slots of people at receivers that show a fixed number of them; poses are held while a person is out of sight."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.data.animation import SkeletonMotion
from pipeline.motion.skeleton.model import forward_kinematics
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

# A slot whose person is out of sight for so long gets the next person; until then it shows the last pose.
_GONE_S = 2.0
# Time in which a person who is back in sight moves from the held pose to the own one.
_BLEND_S = 0.25


class PersonSlots:
    """People in slots: a person keeps the slot while in sight, and for two seconds more."""

    def __init__(self, num_slots: int) -> None:
        self._slots = [_Slot() for _ in range(num_slots)]

    def update(self, instant: LiveInstant) -> list[LivePerson | None]:
        """Person of each slot at an instant; ``None``: the slot is free.

        A person without a skeleton has the last one, for up to two seconds. A skeleton that is back begins with the
        pose that was shown.
        """
        people = {person.id: person for person in instant.people}
        for slot in self._slots:
            if slot.number in people:
                slot.seen_s = instant.time_s
            elif instant.time_s - slot.seen_s > _GONE_S:
                slot.number, slot.shown, slot.held = None, None, None
        waiting = iter(sorted(people.keys() - {slot.number for slot in self._slots}))
        for slot in self._slots:
            if slot.number is None and (number := next(waiting, None)) is not None:
                slot.number, slot.seen_s = number, instant.time_s
        return [slot.update(people.get(slot.number or 0), instant.time_s) for slot in self._slots]


@dataclass(slots=True)
class _Slot:
    number: int | None = None
    seen_s: float = 0.0
    shown: LivePerson | None = None  # Person as last shown
    held: LiveSkeleton | None = None  # Pose that was shown while there was no skeleton
    lost_s: float = 0.0  # Time of the last instant without a skeleton

    def update(self, person: LivePerson | None, time_s: float) -> LivePerson | None:
        before = None if self.shown is None else self.shown.skeleton
        if person is None:
            person = self.shown and replace(self.shown, xyz_m=np.full_like(self.shown.xyz_m, np.nan))
        if person is None or person.skeleton is None or person.skeleton is before:
            self.held, self.lost_s = before, time_s
            person = person and replace(person, skeleton=before)
        elif self.held is not None:
            share = min(1.0, (time_s - self.lost_s) / _BLEND_S)
            person = replace(person, skeleton=blended(self.held, person.skeleton, share * share * (3.0 - 2.0 * share)))
            self.held = self.held if share < 1.0 else None
        self.shown = person
        return person


def blended(first: LiveSkeleton, second: LiveSkeleton, share: float) -> LiveSkeleton:
    """Pose between two of a person, with the bones of the second; ``share`` of the second from 0 to 1."""
    sign = np.where((first.parent_from_joint * second.parent_from_joint).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    quat = (1.0 - share) * sign * first.parent_from_joint + share * second.parent_from_joint
    quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
    root_m = (1.0 - share) * first.root_m + share * second.root_m
    motion = SkeletonMotion(1, "", 0, 1.0, second.bone_length_m, root_m[None], quat[None], ())
    return LiveSkeleton(root_m, quat, second.bone_length_m, forward_kinematics(motion)[0])
