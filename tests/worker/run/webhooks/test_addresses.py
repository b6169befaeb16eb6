"""Addresses that a webhook may have: public networks, and URLs as they are written."""

import pytest

from tests.worker.conftest import RunnerBench
from tests.worker.run.webhooks.conftest import HOUR_S, deliver, queue_for
from tests.worker.run.webhooks.special_addresses import PRIVATE, PUBLIC
from worker.run.webhooks.addresses import is_public, url_fault


def test_special_purpose_addresses_are_not_public() -> None:
    assert [address for address in PRIVATE if is_public(address)] == []
    assert [address for address in PUBLIC if not is_public(address)] == []


WRONG_URLS = [
    "https://a..b/", "https://.b/", "https://a\uff0eb/", "https://127\u30020\u30020\uff611/", "https://b\u00fccher.example/",
    f"https://{'a' * 64}.example/", f"https://{'a.' * 127}example/", "https://-a.example/", "https://a-.example/",
    "https://xn--\u00e4.example/", "https://xn--999999999.example/", "https://xn--.example/", "https://a.example:0/",
    "https://a.example:65536/", "https://a.example:99999999999999999999/", "https://a.example:+1/", "https://2130706433/",
    "https://0x7f000001/", "https://0x7f.1/", "https://127.1/", "https://0177.0.0.1/", "https://127.0.0.1./",
    "https://017700000001/", "https://1.2.3.256/", "https://1.2.3.4.5/", "https://a.0x/", "https://[::1%25lo]/",
    "https://[fe80::1%25eth0]/", "https://[1.2.3.4]/", "https://[v1.a]/", "https://a%2eb/", "https://a,b/", "https://*/",
    "https://a.example/\u00fc", "https://", "https://[", "https://a.example]/",
    "https://[2606:4700::1111]evil.example/", "https://x[2606:4700::1111]/", "https://[2606:4700::1111][::1]/",
    "https://a.example/\x07", "https://a.example/\t", "https://a.example/?\x7f",
]  # fmt: skip


def test_malformed_urls(bench: RunnerBench) -> None:
    assert [url for url in WRONG_URLS if not url_fault(url)] == []
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    for url in WRONG_URLS:
        queue_for(bench, "default", url)
    while deliver(bench):
        pass
    assert [(one.tries, one.problem) for one in bench.store.webhooks.pending()] == [
        (1, url_fault(url)) for url in WRONG_URLS
    ]


RIGHT_HOSTS = [
    "a",
    "a.example",
    "A.EXAMPLE",
    "a.example.",
    "a_b.example",
    "xn--bcher-kva.example",
    "8.8.8.8",
    "[2606::1]",
]


@pytest.mark.parametrize("host", RIGHT_HOSTS)
def test_well_formed_urls(host: str) -> None:
    assert url_fault(f"https://{host}/hook?x=%C3%BC") is None
    assert url_fault(f"https://{host}:65535") is None
