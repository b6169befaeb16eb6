"""`multicap benchmark live --outputs` on a short take."""

import pytest

from api.cli.benchmark import live_outputs


@pytest.mark.slow
def test_cases_have_delays_of_all_instants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_outputs, "_RATE_HZ", 20.0)
    cases = live_outputs.measure_outputs(2.5, rounds=1)
    assert [case["case"] for case in cases] == list(live_outputs._CASES)
    alone, *others = cases
    assert alone["instants"] > 10
    assert alone["received_p99_ms"] is None
    for case in others:
        assert case["instants"] == alone["instants"]
        assert 0 < case["received_p50_ms"] <= case["received_p99_ms"]
