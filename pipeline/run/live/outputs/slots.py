"""Slots of people at receivers that show a fixed number of them."""

from pipeline.run.live.records import LiveInstant, LivePerson

# A slot whose person is out of sight for so long gets the next person.
_GONE_S = 2.0


class PersonSlots:
    """People in slots: a person keeps the slot while in sight, and for two seconds more."""

    def __init__(self, num_slots: int) -> None:
        self._numbers: list[int | None] = [None] * num_slots
        self._seen_s = [0.0] * num_slots

    def update(self, instant: LiveInstant) -> list[LivePerson | None]:
        """Person of each slot at an instant; ``None``: no person is in sight."""
        people = {person.id: person for person in instant.people}
        for slot, number in enumerate(self._numbers):
            if number in people:
                self._seen_s[slot] = instant.time_s
            elif instant.time_s - self._seen_s[slot] > _GONE_S:
                self._numbers[slot] = None
        waiting = iter(sorted(people.keys() - set(self._numbers)))
        for slot, number in enumerate(self._numbers):
            if number is None and (number := next(waiting, None)) is not None:
                self._numbers[slot], self._seen_s[slot] = number, instant.time_s
        return [people.get(number or 0) for number in self._numbers]
