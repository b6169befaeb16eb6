from collections.abc import Callable

from api.settings import Settings
from tests.api.conftest import Live, problem_of, running


def test_alive(live: Live) -> None:
    answer = live.client.get("/healthz")
    assert (answer.status_code, answer.json()) == (200, {"status": "ok"})


def test_not_ready_says_all_that_is_missing(live: Live) -> None:
    answer = live.client.get("/readyz")
    problem = problem_of(answer, 503, "not_ready")
    assert {item["code"] for item in problem["errors"]} == {"broker_unavailable", "model_unavailable"}
    assert "retry-after" in answer.headers


def test_ready(live: Live, make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()
    settings.models_dir.mkdir(parents=True)
    (settings.models_dir / "movenet-multipose.onnx").touch()
    with running(settings) as there:
        there.services.queue.ping = lambda: True  # type: ignore[method-assign]
        answer = there.client.get("/readyz")
        checks = {"database": True, "broker": True, "artifacts": True, "model": True}
        assert (answer.status_code, answer.json()) == (200, {"status": "ready", "checks": checks})
        (settings.models_dir / "movenet-multipose.onnx").unlink()
        (item,) = problem_of(there.client.get("/readyz"), 503, "not_ready")["errors"]
        assert item["code"] == "model_unavailable"
