"""Plain OSC: positions of joints by their names, for TouchDesigner, Max and other programs.

Each person has a bundle: ``/person/1/present`` (1, or 0 while the person is out of sight), ``/person/1/id`` with the
person's number in the capture, and ``/person/1/left_wrist`` x y z in metres for each joint that is known. People keep
their numbers 1 to ``people`` of the address, 4 if it states none. The axes are ours, Z up; ``up=y`` turns them to Y up,
right-handed: (x, z, -y).
"""

from collections.abc import Iterator
from typing import Self

import numpy as np

from pipeline.run.live.outputs.datagrams import DatagramSender, OscTemplate
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.outputs.slots import PersonSlots
from pipeline.run.live.records import LiveInstant, LivePerson

_NUM_PEOPLE = "4"


class OscOutput:
    """Output of plain OSC; see ``LiveOutput``."""

    def __init__(self, start: OutputStart) -> None:
        self._address, options = start.address, start.address.options
        num_people = int(options.get("people", _NUM_PEOPLE))
        self._is_y_up = options.get("up") == "y"
        self._slots = PersonSlots(num_people)
        self._templates = [
            OscTemplate(
                [
                    (f"/person/{number}/present", (), 1),
                    (f"/person/{number}/id", (), 1),
                    *((f"/person/{number}/{joint}", (), 3) for joint in start.joints),
                ]
            )
            for number in range(1, num_people + 1)
        ]
        self._sender = DatagramSender(start.address.host, [start.address.port])

    def __enter__(self) -> Self:
        self._sender.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._sender.__exit__(*error)

    def ready(self) -> str:
        """See ``LiveOutput``."""
        return self._address.text

    def send(self, instant: LiveInstant) -> int:
        """Send the people of an instant; see ``LiveOutput``."""
        return self._sender.send((self._address.port, packet) for packet in self._packets(instant))

    def _packets(self, instant: LiveInstant) -> Iterator[bytes]:
        in_sight = {person.id for person in instant.people}
        for template, person in zip(self._templates, self._slots.update(instant), strict=True):
            if person is None or person.id not in in_sight:
                yield template.packet([0.0], [0])
            else:
                yield self._packet(template, person)

    def _packet(self, template: OscTemplate, person: LivePerson) -> bytes:
        xyz_m = person.xyz_m[:, [0, 2, 1]] * (1.0, 1.0, -1.0) if self._is_y_up else person.xyz_m
        known = np.flatnonzero(np.isfinite(xyz_m).all(-1))
        return template.packet([1.0, person.id, *xyz_m[known].ravel()], [0, 1, *(2 + known)])
