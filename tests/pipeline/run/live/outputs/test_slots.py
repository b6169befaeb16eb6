"""Slots of people: a person keeps the slot, and a slot whose person has gone gets the next one."""

import numpy as np

from pipeline.run.live.outputs.slots import PersonSlots
from pipeline.run.live.records import LiveInstant, LivePerson


def test_slot_keeps_person_and_gets_next_one() -> None:
    slots, shown = PersonSlots(2), []
    for time_s, numbers in [(0.0, (1, 2, 3)), (1.0, (2, 3)), (2.5, (2, 3)), (3.0, (1, 2, 3))]:
        people = tuple(LivePerson(number, np.zeros((17, 3)), None) for number in numbers)
        shown.append([person and person.id for person in slots.update(LiveInstant(time_s, people, 0.0))])
    assert shown == [[1, 2], [None, 2], [3, 2], [3, 2]]
