"""Plain OSC: positions of joints by their names, for TouchDesigner, Max and other programs.

Each person has a bundle: ``/person/1/present`` (1, or 0 while the person is out of sight), ``/person/1/id`` with the
person's number in the capture, and ``/person/1/left_wrist`` x y z in metres for each joint that is known. People keep
their numbers 1 to ``people`` of the address, 4 if it states none. The axes are ours, Z up; ``up=y`` turns them to Y up,
right-handed: (x, z, -y).
"""

from collections.abc import Iterator

import numpy as np

from pipeline.run.live.outputs.datagrams import DatagramOutput, OscTemplate
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.records import LiveInstant, LivePerson

_NUM_PEOPLE = "4"


class OscOutput(DatagramOutput):
    """Output of plain OSC; see ``LiveOutput``."""

    def __init__(self, start: OutputStart) -> None:
        options = start.address.options
        num_people = int(options.get("people", _NUM_PEOPLE))
        super().__init__(start, num_people)
        self._is_y_up = options.get("up") == "y"
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

    def packets(self, instant: LiveInstant) -> Iterator[tuple[int, bytes]]:
        """See ``DatagramOutput``."""
        in_sight = {person.id for person in instant.people}
        for template, person in zip(self._templates, self.slots.update(instant), strict=True):
            packet = template.packet([0.0], [0])
            if person is not None and person.id in in_sight:
                packet = self._packet(template, person)
            yield self.address.port, packet

    def _packet(self, template: OscTemplate, person: LivePerson) -> bytes:
        xyz_m = person.xyz_m[:, [0, 2, 1]] * (1.0, 1.0, -1.0) if self._is_y_up else person.xyz_m
        known = np.flatnonzero(np.isfinite(xyz_m).all(-1))
        return template.packet([1.0, person.id, *xyz_m[known].ravel()], [0, 1, *(2 + known)])
