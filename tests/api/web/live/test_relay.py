"""Relay of a live capture: its coroutines end together."""

import asyncio
from typing import Any

import pytest

from api.web.live.relay import all_or_first_error


def test_watch_that_ends_is_waited_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A watch that has ended, such as a client that sends more after its end, must not keep the loop busy."""
    waits = 0
    wait = asyncio.wait

    async def counted(*arguments: Any, **options: Any) -> object:
        nonlocal waits
        waits += 1
        return await wait(*arguments, **options)

    async def run() -> None:
        ended = asyncio.Event()

        async def way() -> None:
            await ended.wait()

        async def watch() -> None:
            asyncio.get_running_loop().call_later(0.05, ended.set)

        await all_or_first_error((way(),), (watch(),))

    monkeypatch.setattr(asyncio, "wait", counted)
    asyncio.run(run())
    assert waits == 2


def test_error_of_watch_ends_all() -> None:
    canceled = []

    async def way() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            canceled.append("way")

    async def watch() -> None:
        await asyncio.sleep(0)
        raise ValueError("key")

    async def run() -> None:
        await all_or_first_error((way(),), (watch(),))

    with pytest.raises(ValueError, match="key"):
        asyncio.run(run())
    assert canceled == ["way"]
