"""Threads that owners share: no owner has all threads, owners take turns, waiting times are limited."""

import asyncio
import threading
from collections.abc import Callable

import pytest

from api.web.errors import ApiError
from api.web.http.fair_share import threads_of_checks

WAIT_S = 30.0


class HeldCalls:
    """Calls that run until the test ends them."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self._go_on = threading.Event()

    def __call__(self, name: str) -> str:
        self.begun.append(name)
        assert self._go_on.wait(WAIT_S)
        return name

    def end(self) -> None:
        self._go_on.set()


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(WAIT_S):
        while not condition():
            await asyncio.sleep(0.005)


async def settled(calls: list[asyncio.Task[str]]) -> None:
    """Run the event loop until waiting calls could have started."""
    for _ in range(20):
        await asyncio.sleep(0.005)
    assert not any(call.done() for call in calls)


def test_one_owner_never_has_all_threads() -> None:
    async def scenario() -> None:
        threads, work = threads_of_checks(3, WAIT_S), HeldCalls()
        many = [asyncio.create_task(threads.run("many", work, f"many {k}")) for k in range(5)]
        await until(lambda: len(work.begun) == 2)
        await settled(many)
        assert sorted(work.begun) == ["many 0", "many 1"]
        other = asyncio.create_task(threads.run("other", work, "other"))
        await until(lambda: "other" in work.begun)
        work.end()
        assert await asyncio.gather(*many, other) == [*(f"many {k}" for k in range(5)), "other"]

    asyncio.run(scenario())


def test_owners_take_turns_however_many_calls_they_have() -> None:
    async def scenario() -> None:
        threads, first = threads_of_checks(1, WAIT_S), HeldCalls()
        order: list[str] = []
        holding = asyncio.create_task(threads.run("a", first, "first"))
        await until(lambda: bool(first.begun))
        calls = [asyncio.create_task(threads.run(name[0], order.append, name)) for name in ("a1", "a2", "a3")]
        await asyncio.sleep(0)
        calls += [asyncio.create_task(threads.run(name[0], order.append, name)) for name in ("b1", "b2", "c1")]
        await asyncio.sleep(0)
        first.end()
        await asyncio.gather(holding, *calls)
        assert order == ["a1", "b1", "c1", "a2", "b2", "a3"]

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("owner", "status", "code"), [("holder", 429, "too_many_checks"), ("other", 503, "checks_busy")]
)
def test_waiting_times_are_limited(owner: str, status: int, code: str) -> None:
    async def scenario() -> ApiError:
        threads, work = threads_of_checks(1, 0.1), HeldCalls()
        holding = asyncio.create_task(threads.run("holder", work, "holder"))
        await until(lambda: bool(work.begun))
        with pytest.raises(ApiError) as raised:
            await threads.run(owner, work, "late")
        work.end()
        await holding
        assert await threads.run(owner, work, "again") == "again"
        assert work.begun == ["holder", "again"]
        return raised.value

    error = asyncio.run(scenario())
    assert (error.status, error.code, error.retryable) == (status, code, True)
    assert int(error.headers["Retry-After"]) > 0


def test_no_owner_has_more_than_some_calls_waiting() -> None:
    async def scenario() -> None:
        threads, work = threads_of_checks(2, WAIT_S), HeldCalls()
        calls = [asyncio.create_task(threads.run("many", work, "many")) for _ in range(33)]
        await until(lambda: bool(work.begun))
        for refused in (threads.run("many", work, "many"), asyncio.to_thread(threads.require_room, "many")):
            with pytest.raises(ApiError) as raised:
                await refused
            assert (raised.value.status, raised.value.code) == (429, "too_many_checks")
        threads.require_room("other")
        work.end()
        await asyncio.gather(*calls)

    asyncio.run(scenario())


def test_calls_that_are_given_up_leave_their_turns_to_others() -> None:
    async def scenario() -> None:
        threads, work = threads_of_checks(1, WAIT_S), HeldCalls()
        holding = asyncio.create_task(threads.run("a", work, "a"))
        await until(lambda: bool(work.begun))
        waiting = [asyncio.create_task(threads.run("b", work, "b")) for _ in range(3)]
        await asyncio.sleep(0)
        waiting[0].cancel()
        work.end()
        assert await asyncio.gather(holding, *waiting[1:]) == ["a", "b", "b"]
        assert waiting[0].cancelled()
        assert await threads.run("c", work, "c") == "c"

    asyncio.run(scenario())


def test_turn_comes_at_moment_of_giving_up() -> None:
    async def scenario() -> None:
        threads, work = threads_of_checks(1, WAIT_S), HeldCalls()
        work.end()
        held = asyncio.create_task(threads.run("a", work, "a"))
        waiting = asyncio.create_task(threads.run("b", work, "b"))
        held.add_done_callback(lambda _: waiting.cancel())
        await asyncio.wait([held, waiting])
        assert await threads.run("c", work, "c") == "c"

    asyncio.run(scenario())


def test_call_that_fails_ends_its_turn() -> None:
    async def scenario() -> None:
        threads = threads_of_checks(1, WAIT_S)
        for _ in range(3):
            with pytest.raises(ZeroDivisionError):
                await threads.run("a", lambda: 1 // 0)

    asyncio.run(scenario())
