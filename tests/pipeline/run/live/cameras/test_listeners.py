"""Receivers of VMC of a live capture from cameras: each shows one person."""

import socket

import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.run.live.cameras.listeners import VmcReceivers, vmc_receivers
from pipeline.run.live.records import LiveInstant, LivePerson


class PersonReceiver:
    """PersonReceiver of VMC that notes whom it got."""

    def __init__(self) -> None:
        self.got: list[float] = []

    def send(self, instant: LiveInstant) -> int:
        (person,) = instant.people
        assert person.id == 1
        self.got.append(float(person.xyz_m[0, 0]))
        return 1


def test_receiver_keeps_its_person_and_gets_next_one() -> None:
    receivers = [PersonReceiver(), PersonReceiver()]
    vmc = VmcReceivers(receivers)  # type: ignore[arg-type]
    for time_s, numbers in [(0.0, (1, 2, 3)), (1.0, (2, 3)), (2.5, (2, 3)), (3.0, (1, 2, 3))]:
        people = tuple(LivePerson(number, np.full((17, 3), float(number)), None) for number in numbers)
        vmc.show(LiveInstant(time_s, people, 0.0), 0.0)
    assert [receiver.got for receiver in receivers] == [[1, 3, 3], [2, 2, 2, 2]]


def test_wrong_receivers_all_problems_at_once() -> None:
    addresses = ["39539", "127.0.0.1:39539", "port", "127.0.0.1:70000"]
    with pytest.raises(InputError) as refused, vmc_receivers(addresses, allow_network=False):
        pass
    messages = [problem.message for problem in refused.value.problems]
    assert messages == [
        "'port' is not [HOST:]PORT.",
        "Ports are numbers from 1 to 65535.",
        "The receiver 127.0.0.1:39539 is stated twice.",
    ]


def test_receiver_is_told_of_person() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        with vmc_receivers([str(receiver.getsockname()[1])], allow_network=False) as vmc:
            vmc.show(LiveInstant(0.0, (LivePerson(7, np.zeros((17, 3)), None),), 0.0), 0.0)
            assert b"/VMC/Ext/OK" in receiver.recv(65_536)
