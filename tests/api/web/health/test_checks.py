"""Checks with a time limit."""

import threading

import pytest

from api.web.health.checks import LimitedChecks


def test_results_by_name() -> None:
    assert LimitedChecks(60.0).run({"left": lambda: 1, "right": lambda: 2}) == {"left": 1, "right": 2}


def test_check_that_hangs_is_reported_and_not_begun_again() -> None:
    release, begun = threading.Event(), threading.Semaphore(0)

    def hang() -> bool:
        begun.release()
        return release.wait(60)

    checks = LimitedChecks(0.2)
    for _ in range(3):
        assert checks.run({"hangs": hang, "responds": lambda: True}) == {"hangs": None, "responds": True}
    release.set()
    assert LimitedChecks(60.0).run({"hangs": hang}) == {"hangs": True}
    checks = LimitedChecks(60.0)
    assert checks.run({"hangs": hang}) == {"hangs": True}
    assert begun.acquire(blocking=False)
    assert begun.acquire(blocking=False)
    assert begun.acquire(blocking=False)
    assert not begun.acquire(blocking=False)


@pytest.mark.parametrize("error", [ValueError, TimeoutError])
def test_error_of_check_is_raised(error: type[Exception]) -> None:
    def fail() -> bool:
        raise error

    with pytest.raises(error):
        LimitedChecks(60.0).run({"fails": fail})
