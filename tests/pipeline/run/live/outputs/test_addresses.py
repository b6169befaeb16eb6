"""Addresses of outputs: all that is wrong comes at once, other machines on request only."""

from importlib.util import find_spec

import pytest

from pipeline.core.errors import InputError
from pipeline.run.live.outputs.addresses import read_outputs


def test_address_parts_are_read() -> None:
    plain, full = read_outputs(["vmc://localhost", " VMC://[::1]:40000?people=2&person=3 "], allow_network=False)
    assert (plain.scheme, plain.host, plain.port, dict(plain.options)) == ("vmc", "127.0.0.1", 39539, {})
    assert (full.host, full.port, dict(full.options)) == ("::1", 40000, {"people": "2", "person": "3"})
    assert (plain.text, full.text) == ("vmc://127.0.0.1:39539", "vmc://[::1]:40000?people=2&person=3")


def test_wrong_addresses_all_problems_at_once() -> None:
    texts = ["39539", "vmc://localhost", "vmc://127.0.0.1:39539", "vmc://:39539", "vmc://127.0.0.1:70000"]
    texts += [
        "vmc://a:0",
        "vmc://no such host.invalid",
        "vmc://192.0.2.7",
        "vmc://127.0.0.1?people=0&axes=y",
        "gopher://a",
    ]
    with pytest.raises(InputError) as refused:
        read_outputs(texts, allow_network=False)
    assert [problem.message for problem in refused.value.problems] == [
        "'39539' is no address of an output.",
        "'vmc://:39539' is no address of VMC.",
        "'vmc://127.0.0.1:70000' is no address of VMC.",
        "'vmc://a:0' is no address of VMC.",
        "The host 'no such host.invalid' is not known.",
        "'vmc://192.0.2.7' is on another machine, and VMC has neither keys nor encryption.",
        "people of an output is 1 to 32, not '0'.",
        "Addresses of VMC have no parameter 'axes'.",
        "'gopher://a' is no address of an output.",
        "vmc://127.0.0.1:39539 is stated twice.",
    ]


@pytest.mark.parametrize(
    "text",
    [
        *("osc://127.0.0.1:9000/person", "osc://127.0.0.1#person", "osc://user@127.0.0.1", "osc://127.0.0.1?people"),
        *("osc://127.0.0.1?people=2&people=3", "osc://[127.0.0.1", "osc://127.0.0.1:-1"),
    ],
)
def test_address_with_unread_part_is_refused(text: str) -> None:
    """No part of an address is passed over: a program would wait for what was not meant."""
    with pytest.raises(InputError) as refused:
        read_outputs([text], allow_network=True)
    (problem,) = refused.value.problems
    assert (problem.message, problem.hint) == (f"{text!r} is no address of OSC.", "Write osc://HOST:9000.")


@pytest.mark.skipif(find_spec("pylsl") is None, reason="pylsl is not installed (the extra `lsl`)")
def test_stream_with_unread_parameter_is_refused() -> None:
    for text in ("lsl://stage?people", "lsl://?people=2", "lsl://sta\x00ge", "lsl://" + "s" * 65):
        with pytest.raises(InputError, match="is no address of LSL"):
            read_outputs([text], allow_network=True)


@pytest.mark.parametrize(
    ("text", "num_ports"), [("vmc://127.0.0.1:65535?people=2", 2), ("qtm://:65532", 5), ("qtm://:65535", 5)]
)
def test_ports_behind_the_last_are_refused(text: str, num_ports: int) -> None:
    with pytest.raises(InputError) as refused:
        read_outputs([text], allow_network=False)
    (problem,) = refused.value.problems
    assert problem.message == f"{text!r} needs {num_ports} ports, and 65535 is the last."


def test_last_ports_are_taken() -> None:
    texts = ["vmc://127.0.0.1:65534?people=2", "qtm://:65531", "osc://127.0.0.1:65535?people=32"]
    assert [address.port for address in read_outputs(texts, allow_network=False)] == [65534, 65531, 65535]


def test_port_of_two_people_is_refused() -> None:
    """A receiver of VMC shows one person: two would alternate."""
    with pytest.raises(InputError) as refused:
        read_outputs(["vmc://127.0.0.1:39539?people=2", "vmc://127.0.0.1:39540"], allow_network=False)
    assert [problem.message for problem in refused.value.problems] == ["vmc://127.0.0.1:39540 is stated twice."]


def test_other_machines_are_allowed_on_request() -> None:
    (address,) = read_outputs(["vmc://192.0.2.7"], allow_network=True)
    assert address.is_network


def test_name_of_stream_reaches_network() -> None:
    """LSL listens at all addresses of the machine: it is allowed on request, where its package is installed."""
    with pytest.raises(InputError) as refused:
        read_outputs(["lsl://stage left?people=2"], allow_network=False)
    if find_spec("pylsl") is None:
        assert [problem.message for problem in refused.value.problems] == ["LSL needs the package pylsl."]
        return
    assert [problem.hint for problem in refused.value.problems] == ["Allow the network."]
    (address,) = read_outputs(["lsl://stage left?people=2"], allow_network=True)
    assert (address.host, address.is_network, address.text) == ("stage left", True, "lsl://stage left?people=2")


def test_link_local_address_keeps_its_scope() -> None:
    """Without the scope no socket can be connected to it."""
    (address,) = read_outputs(["vmc://[fe80::1%lo]:39539"], allow_network=True)
    assert (address.host, address.text) == ("fe80::1%lo", "vmc://[fe80::1%lo]:39539")
