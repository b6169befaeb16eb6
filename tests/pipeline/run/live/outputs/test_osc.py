"""Plain OSC: what a server of another library gets."""

import numpy as np
import pytest

from pipeline.run.live.outputs.addresses import read_outputs
from pipeline.run.live.outputs.osc import OscOutput
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.records import LiveInstant, LivePerson
from tests.pipeline.run.live.outputs.test_vmc import received

JOINTS = ("nose", "left_wrist", "right_wrist")
WRIST_M = (0.5, -1.25, 1.5)


def instant(time_s: float, *people: int) -> LiveInstant:
    xyz_m = np.array([[0.0, 0.25, 1.75], WRIST_M, [np.nan] * 3])
    return LiveInstant(time_s, tuple(LivePerson(number, xyz_m, None) for number in people), 0.0)


def sent_to(port: int, options: str, *instants: LiveInstant) -> list[int]:
    (address,) = read_outputs([f"osc://127.0.0.1:{port}{options}"], allow_network=False)
    with OscOutput(OutputStart(address, 25.0, JOINTS)) as output:
        return [output.send(given) for given in instants]


@pytest.mark.parametrize(("options", "wrist_m"), [("", WRIST_M), ("&up=y", (0.5, 1.5, 1.25))])
def test_receiver_gets_known_joints_of_people(options: str, wrist_m: tuple[float, ...]) -> None:
    messages = received(lambda port: sent_to(port, f"?people=3{options}", instant(1.0, 4, 9)), 9)
    by_address = {address: values for address, *values in messages}
    assert by_address["/person/1/left_wrist"] == by_address["/person/2/left_wrist"] == list(wrist_m)
    assert (by_address["/person/1/id"], by_address["/person/2/id"]) == ([4.0], [9.0])
    assert [by_address[f"/person/{number}/present"] for number in (1, 2, 3)] == [[1.0], [1.0], [0.0]]
    assert not [address for address in by_address if "right_wrist" in address]


def test_person_out_of_sight_is_not_present() -> None:
    messages = received(lambda port: sent_to(port, "?people=1", instant(1.0, 4), instant(1.5)), 5)
    assert messages[-1] == ("/person/1/present", 0.0)
    assert len(messages) == 5
