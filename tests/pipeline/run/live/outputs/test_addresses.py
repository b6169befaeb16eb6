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
        "'vmc://:39539' has no right host and port.",
        "'vmc://127.0.0.1:70000' has no right host and port.",
        "'vmc://a:0' has no right host and port.",
        "The host 'no such host.invalid' is not known.",
        "'vmc://192.0.2.7' is on another machine, and VMC has neither keys nor encryption.",
        "people of an output is 1 to 32, not '0'.",
        "Addresses of VMC have no parameter 'axes'.",
        "'gopher://a' is no address of an output.",
        "vmc://127.0.0.1:39539 is stated twice.",
    ]


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
