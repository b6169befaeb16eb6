"""Receivers that hang, drip, flood or hang up: every attempt ends in its time."""

import time
from collections.abc import Callable

import pytest

from tests.worker.conftest import RunnerBench
from tests.worker.run.webhooks.conftest import HOUR_S, Receiver, deliver, end_job, make_due, message, secret
from worker.run.webhooks.sender import Sender
from worker.store.repositories.webhooks import MAX_TRIES

# Limit of an attempt that reaches it, and of one that ends by itself, on a busy machine too.
REACHED_S, AMPLE_S = 0.6, 20.0


@pytest.mark.parametrize(
    ("first", "try_s", "problem"),
    [
        (b"", REACHED_S, "The answer took too long."),
        (b"HTTP/1.1 200 OK\r\nX-", REACHED_S, "The answer took too long."),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 999999999\r\n\r\n", AMPLE_S, None),
        (b"SSH-2.0-OpenSSH\r\n\r\n", AMPLE_S, "The connection failed."),
    ],
)
def test_attempt_has_time_limit(
    dripping: Callable[[bytes], str], first: bytes, try_s: float, problem: str | None
) -> None:
    assert Sender(allow_private=True, try_s=try_s).send(message(dripping(first)), secret()) == problem


class TestBadReceivers:
    """Misbehaving servers on loopback: every attempt ends in time and is recorded with its reason."""

    def problem_after_attempt(self, bench: RunnerBench, url: str, try_s: float = AMPLE_S) -> str | None:
        """Send a message to a URL and return the recorded problem."""
        bench.store.webhook_secrets.rotate("default", HOUR_S)
        end_job(bench, url)
        started_s = time.monotonic()
        assert deliver(bench, Sender(allow_private=True, try_s=try_s)) == 1
        assert time.monotonic() - started_s < try_s + 3
        (left,) = bench.store.webhooks.pending()
        assert left.tries == 1
        assert left.due_at.timestamp() - time.time() > 3  # on the schedule
        return left.problem

    def test_never_answers(self, bench: RunnerBench, silent: str) -> None:
        assert self.problem_after_attempt(bench, silent, REACHED_S) == "The answer took too long."

    def test_never_answers_to_tls(self, bench: RunnerBench, silent: str) -> None:
        address = silent.replace("http:", "https:")
        assert self.problem_after_attempt(bench, address, REACHED_S) == "The answer took too long."

    def test_drips_handshake(self, bench: RunnerBench, dripping: Callable[[bytes], str]) -> None:
        # Header of a TLS record; its 16,384 bytes follow one at a time.
        address = dripping(b"\x16\x03\x03\x40\x00").replace("http:", "https:")
        assert self.problem_after_attempt(bench, address, REACHED_S) == "The answer took too long."

    @pytest.mark.parametrize("first", [b"", b"HTTP/1.1 200 OK\r\nX-", b"HTTP/1.1 20"])
    def test_drips_answer(self, bench: RunnerBench, dripping: Callable[[bytes], str], first: bytes) -> None:
        assert self.problem_after_attempt(bench, dripping(first), REACHED_S) == "The answer took too long."

    @pytest.mark.parametrize("piece", [b"X-More: " + b"x" * 8000 + b"\r\n", b"HTTP/1.1 100 Continue\r\n\r\n"])
    def test_headers_without_end(self, bench: RunnerBench, flooding: Callable[[bytes], str], piece: bytes) -> None:
        assert self.problem_after_attempt(bench, flooding(piece), REACHED_S) in {
            "The connection failed.",
            "The answer took too long.",
        }

    @pytest.mark.parametrize("with_answer", [b"", b"HTTP/1.1 200"])
    def test_closes_at_once(self, bench: RunnerBench, closing: Callable[[bytes], str], with_answer: bytes) -> None:
        assert self.problem_after_attempt(bench, closing(with_answer)) == "The connection failed."

    def test_no_server_listens(self, bench: RunnerBench) -> None:
        assert self.problem_after_attempt(bench, "http://127.0.0.1:1/") == "The connection failed."

    def test_speaks_no_tls(self, bench: RunnerBench, receiver: Receiver) -> None:
        address = receiver.url.replace("http:", "https:")
        assert self.problem_after_attempt(bench, address) == "The TLS handshake failed."

    def test_redirects_are_not_followed(self, bench: RunnerBench, receiver: Receiver) -> None:
        receiver.statuses = [302]
        assert self.problem_after_attempt(bench, receiver.url) == "It was answered with 302."
        assert receiver.paths == ["/hook?x=1"]

    def test_is_given_up_after_last_try(self, bench: RunnerBench, silent: str) -> None:
        bench.store.webhook_secrets.rotate("default", HOUR_S)
        end_job(bench, silent)
        for _ in range(MAX_TRIES):
            assert len(bench.store.webhooks.pending()) == 1
            make_due(bench)
            assert deliver(bench, Sender(allow_private=True, try_s=0.05)) == 1
        assert bench.store.webhooks.pending() == []
