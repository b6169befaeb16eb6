"""Cache of a function for all threads of a process. Standard library only."""

import functools
import threading
from collections.abc import Callable, Hashable
from typing import TypeVar

_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


def once_a_process(function: Callable[[_Key], _Value]) -> Callable[[_Key], _Value]:
    """Cache the values of a function of one argument; threads that ask for a value at the same time get the same one.

    ``functools.cache`` would call the function in each of them: a network would be loaded twice.
    """
    lock, cached = threading.Lock(), functools.cache(function)

    @functools.wraps(function)
    def locked(key: _Key) -> _Value:
        with lock:
            return cached(key)

    return locked
