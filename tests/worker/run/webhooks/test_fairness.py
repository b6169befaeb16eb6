"""Slow receivers delay no other receiver, and tenants take turns."""

import contextlib
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from tests.worker.conftest import RunnerBench
from tests.worker.run.webhooks.conftest import (
    HOUR_S,
    Receiver,
    deliver,
    end_job,
    make_due,
    queue_for,
)
from worker.run.webhooks import sender as webhooks
from worker.run.webhooks.sender import Sender


def test_hanging_receiver_delays_no_other_receiver(
    bench: RunnerBench, receiver: Receiver, dripping: Callable[[bytes], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, dripping(b""))
    end_job(bench, receiver.url)
    assert deliver(bench, Sender(allow_private=True, try_s=0.5)) == 2
    assert len(receiver.received) == 1
    assert [one.problem for one in bench.store.webhooks.pending()] == ["The answer took too long."]


def test_slow_receivers_of_tenant_do_not_delay_other_tenants(
    bench: RunnerBench, receiver: Receiver, silent: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One tenant has forty messages to a hanging receiver; then another tenant has one, in the service's loop."""
    for tenant in ("default", "other"):
        bench.store.webhook_secrets.rotate(tenant, HOUR_S)
    for _ in range(40):
        queue_for(bench, "default", silent)
    try_s, ended = 3.0, threading.Event()

    class Ending:
        """Messages of the store; they end the sender's loop when the test is over."""

        def __getattr__(self, name: str) -> Any:
            if ended.is_set() and name == "claim":
                raise KeyboardInterrupt
            return getattr(bench.store.webhooks, name)

    store = SimpleNamespace(webhooks=Ending(), webhook_secrets=bench.store.webhook_secrets)

    def send() -> None:
        with contextlib.suppress(KeyboardInterrupt):
            webhooks.deliver_forever(store, Sender(allow_private=True, try_s=try_s))  # type: ignore[arg-type]

    monkeypatch.setattr(webhooks, "_LOOK_S", 0.1)
    sending = threading.Thread(target=send)
    sending.start()
    try:
        deadline_s = time.monotonic() + 120
        while sum(one.tries for one in bench.store.webhooks.pending()) < 8:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        started_s = time.monotonic()
        queue_for(bench, "other", receiver.url)
        while not receiver.received:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        assert time.monotonic() - started_s < try_s
    finally:
        ended.set()
        sending.join(20)
    assert not sending.is_alive()


def test_tenants_take_turns(bench: RunnerBench) -> None:
    for tenant in ["default"] * 6 + ["second", "third", "second"]:
        queue_for(bench, tenant, "https://hook.example/")

    def claimed(limit: int, busy: dict[str, int]) -> list[str]:
        found = sorted(one.tenant for one in bench.store.webhooks.claim(limit, 60.0, 3, busy))
        make_due(bench)
        return found

    assert claimed(3, {}) == ["default", "second", "third"]
    assert claimed(9, {}) == ["default"] * 3 + ["second"] * 2 + ["third"]
    assert claimed(9, {"default": 3, "second": 2}) == ["second", "third"]
    assert claimed(2, {"second": 1}) == ["default", "third"]
