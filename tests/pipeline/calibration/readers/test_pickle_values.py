"""Values and arrays are read from pickles, and nothing else."""

import pickle
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from pipeline.calibration.readers.pickles import read_values
from pipeline.core.parsing import UnreadableError

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=4),
    max_leaves=10,
)


@given(value=PLAIN, protocol=st.integers(0, 5))
def test_plain_values(value: Any, protocol: int) -> None:
    assert read_values(pickle.dumps(value, protocol)) == value


@given(
    value=arrays(
        st.sampled_from(["<f8", ">f8", "<f4", "<i8", "<i4", "|u1"]),
        array_shapes(min_dims=1, max_dims=3, max_side=4),
        elements={"min_value": 0, "max_value": 100},
    ),
    protocol=st.integers(3, 5),
    is_fortran=st.booleans(),
)
def test_arrays(value: np.ndarray, protocol: int, is_fortran: bool) -> None:
    stored = np.asfortranarray(value) if is_fortran else value
    assert read_values(pickle.dumps({"array": stored}, protocol)) == {"array": value.astype(float).tolist()}


def test_numbers_of_numpy() -> None:
    assert read_values(pickle.dumps([np.float64(1.5), np.int32(-3)])) == [1.5, -3.0]


class Evil:
    """Object whose pickle calls a function."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> Any:
        return self.call


def called(*_: Any) -> None:
    """Fail the test when a pickle has called a function."""
    pytest.fail("a pickle ran code")


# Each list contains the one before it many times: small in the file, 100 ** 9 items.
def billion() -> Any:
    value: Any = [0]
    for _ in range(9):
        value = [value] * 100
    return value


def endless() -> Any:
    value: list[Any] = []
    value.append(value)
    return value


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize(
    "value",
    [
        Evil(called),
        {"K": Evil(called, 1)},
        Evil(np.load, "/etc/passwd"),
        Evil(eval, "1"),
        np.array([Evil(called)], dtype=object),
        np.dtype("f8"),
        np.array(["text"]),
        called,
        {1: 2},
        {1, 2},
        1j,
        billion(),
        endless(),
    ],
    ids=lambda value: type(value).__name__,
)
def test_hostile_values_are_refused(value: Any, protocol: int) -> None:
    content = pickle.dumps(value, protocol)
    with pytest.raises(UnreadableError):
        read_values(content)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b".",
        b"N",
        b"(.",
        b"\x80\x04K\x01K\x02.",
        b"cos\nsystem\n(S'true'\ntR.",
        b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x04true\x85R.",
        b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x7f",
        b"\x80\x02\x8b\xff\xff\xff\x7f1.",
        b"\x80\x02Nr\xff\xff\xff\xffj\x00\x00\x00\x00.",
        b"\x80\x04P1\n.",
        b"\x80\x02\x82\x01.",
        b"\x80\x04]" + b"]a" * 110_000 + b".",
        b"\x80\x04" + b"N" * 1_100_000 + b".",
        pickle.dumps([np.zeros(3)])[:-20],
    ],
)
def test_damaged_pickles_are_refused(content: bytes) -> None:
    with pytest.raises(UnreadableError):
        read_values(content)


def test_named_length_takes_no_memory() -> None:
    content = b"".join((pickle.PROTO, b"\x05", pickle.BYTEARRAY8, (2**28).to_bytes(8, "little"), b"abc", pickle.STOP))
    tracemalloc.start()
    try:
        with pytest.raises(UnreadableError):
            read_values(content)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()
