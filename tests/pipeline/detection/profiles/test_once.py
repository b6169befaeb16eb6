"""Values that are made once for all threads."""

import threading

import pytest

from pipeline.detection.profiles.profile_detector import once_a_process


def test_threads_that_ask_at_same_time_get_one_value() -> None:
    calls: list[str] = []
    is_asked_again = threading.Event()

    @once_a_process
    def load(name: str) -> object:
        calls.append(name)
        is_asked_again.wait(1.0)  # with a second call at the same time it would be set
        return object()

    found: list[object] = []

    def ask() -> None:
        found.append(load("a"))
        is_asked_again.set()

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert calls == ["a"]
    assert len(set(map(id, found))) == 1
    assert load("b") is not found[0]


def test_error_is_not_kept() -> None:
    results: list[object] = [ValueError("not installed"), 3]

    @once_a_process
    def load(name: str) -> object:
        result = results.pop(0)
        if isinstance(result, ValueError):
            raise result
        return result

    with pytest.raises(ValueError, match="not installed"):
        load("a")
    assert load("a") == load("a") == 3
