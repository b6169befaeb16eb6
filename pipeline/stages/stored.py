"""Sequence of records that are made anew whenever they are asked for."""

from collections.abc import Callable, Sequence
from typing import TypeVar, overload

_Record = TypeVar("_Record")


class StoredSequence(Sequence[_Record]):
    """Records, each read or made anew whenever it is asked for: all of a long session's are large.

    Parameters
    ----------
    num_records
        How many there are.
    read
        Reads the one with a number.
    """

    def __init__(self, num_records: int, read: Callable[[int], _Record]) -> None:
        self._numbers, self._read = range(num_records), read

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> _Record: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[_Record]: ...

    def __getitem__(self, index: int | slice) -> _Record | Sequence[_Record]:
        numbers = self._numbers[index]
        return self._read(numbers) if isinstance(numbers, int) else [self._read(number) for number in numbers]
