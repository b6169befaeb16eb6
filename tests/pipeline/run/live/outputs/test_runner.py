"""Outputs while they run: none delays the capture or another one, and each tells its state."""

import socket
import threading
import time
from collections.abc import Callable
from typing import Self

import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.run.live.outputs import addresses
from pipeline.run.live.outputs.addresses import OutputProtocol
from pipeline.run.live.outputs.output import LiveOutput
from pipeline.run.live.outputs.pattern import LAYOUT, pattern_instants
from pipeline.run.live.outputs.runner import LiveOutputs, OutputStatus
from pipeline.run.live.records import LiveInstant, LivePerson

SENT: list[float] = []
HANGS, BEGUN = threading.Event(), threading.Event()


class SlowOutput(LiveOutput):
    """Output whose receiver takes nothing until it is told to."""

    def __exit__(self, *error: object) -> None: ...

    def send(self, instant: LiveInstant) -> int:
        BEGUN.set()
        HANGS.wait(30)
        SENT.append(instant.time_s)
        return 1


class FaultyOutput(SlowOutput):
    """Output with a fault: it raises for the second instant."""

    def send(self, instant: LiveInstant) -> int:
        if instant.time_s == 1.0:
            raise KeyError("LeftHand")
        return 1


class ClosedOutput(SlowOutput):
    """Output whose address can't be used."""

    def __enter__(self) -> Self:
        raise OSError(98, "Address already in use")


@pytest.fixture
def protocols(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protocols of the outputs above."""
    SENT.clear()
    HANGS.clear()
    BEGUN.clear()
    further = {
        "slow": OutputProtocol("Slow", f"{__name__}:SlowOutput", 1),
        "faulty": OutputProtocol("Faulty", f"{__name__}:FaultyOutput", 1),
        "closed": OutputProtocol("Closed", f"{__name__}:ClosedOutput", 2, is_server=True),
    }
    monkeypatch.setattr(addresses, "OUTPUTS", {**addresses.OUTPUTS, **further})


def instant_at(time_s: float) -> LiveInstant:
    return LiveInstant(time_s, (LivePerson(1, np.zeros((17, 3)), None),), 0.0)


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 20
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.01)
    assert condition()


@pytest.mark.usefixtures("protocols")
def test_output_that_hangs_drops_oldest_and_others_continue() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(20)
        with LiveOutputs([f"vmc://127.0.0.1:{receiver.getsockname()[1]}", "slow://127.0.0.1"]) as outputs:
            outputs.begin(["nose"], 25.0)
            vmc, slow = outputs.statuses
            for number in range(20):
                outputs.show(instant_at(float(number)))
                receiver.recv(65_536)
                assert BEGUN.wait(20)
            wait_for(lambda: vmc.sent == 20)
            assert (vmc.state, vmc.dropped, slow.sent, slow.dropped) == ("sending", 0, 0, 17)
            HANGS.set()
            wait_for(lambda: slow.sent == 3)
            assert SENT[-2:] == [18.0, 19.0]


@pytest.mark.usefixtures("protocols")
def test_fault_of_output_is_told_and_next_instant_is_sent() -> None:
    with LiveOutputs(["faulty://127.0.0.1"]) as outputs:
        outputs.begin(["nose"], 25.0)
        (faulty,) = outputs.statuses
        for time_s, state, counts in ((0.0, "sending", (1, 0)), (1.0, "failed", (1, 1)), (2.0, "sending", (2, 1))):
            outputs.show(instant_at(time_s))
            wait_for(lambda counts=counts: (faulty.sent, faulty.failed) == counts)  # type: ignore[misc]
            assert faulty.state == state
            assert (faulty.message is None) == (state == "sending")
            assert faulty.message in {None, "internal error, KeyError: 'LeftHand'"}


def test_fault_of_fingers_is_told_by_all_outputs() -> None:
    """People without the joints of fingers come although the capture states them."""
    with LiveOutputs(["vmc://127.0.0.1:39540", "osc://127.0.0.1:39550"]) as outputs:
        outputs.begin(LAYOUT.joints.names, 25.0)
        skeleton = pattern_instants()(0).people[0].skeleton
        outputs.show(LiveInstant(0.0, (LivePerson(1, np.zeros((2, 3)), skeleton),), 0.0))
        wait_for(lambda: all(status.failed == 1 for status in outputs.statuses))
        assert {status.state for status in outputs.statuses} == {"failed"}


def test_output_without_receiver_says_so_until_one_comes() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        port = receiver.getsockname()[1]
    with LiveOutputs([f"vmc://127.0.0.1:{port}"]) as outputs:
        outputs.begin(["nose"], 25.0)
        (status,) = outputs.statuses

        def state_after_instant(state: str) -> bool:
            outputs.show(instant_at(0.0))
            return status.state == state

        wait_for(lambda: state_after_instant("no receiver"))
        assert status.failed > 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.bind(("127.0.0.1", port))
            wait_for(lambda: state_after_instant("sending"))
        assert status.message is None


@pytest.mark.usefixtures("protocols")
def test_outputs_that_cannot_be_opened_are_told_at_once() -> None:
    with LiveOutputs(["closed://", "closed://:3", "slow://127.0.0.1"]) as outputs, pytest.raises(InputError) as refused:
        outputs.begin(["nose"], 25.0)
    assert [problem.message for problem in refused.value.problems] == [
        "closed://127.0.0.1:2 can't be opened: Address already in use.",
        "closed://127.0.0.1:3 can't be opened: Address already in use.",
    ]


def test_status_document_is_json() -> None:
    document = OutputStatus("vmc://127.0.0.1:39539", "VMC").document()
    assert document == {
        "address": "vmc://127.0.0.1:39539",
        "protocol": "VMC",
        "state": "waiting",
        "message": None,
        "sent": 0,
        "dropped": 0,
        "failed": 0,
    }
