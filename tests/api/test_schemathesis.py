"""Requests made from the contract, right and wrong ones: no answer may be one that the contract does not know."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, settings
from schemathesis.specs.openapi.checks import positive_data_acceptance

from api.openapi import COMMITTED
from api.settings import KIB, Settings
from tests.api.conftest import Live, running

schema = schemathesis.openapi.from_path(COMMITTED)
CASES_EACH = 40

cases = 0


@pytest.fixture(scope="module")
def service(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Limits above what a schema can say, so that nothing is too large before it is wrong."""
    with running(make_settings(max_json_bytes=64 * KIB)) as live:
        yield live


@pytest.fixture(scope="module")
def known(service: Live) -> dict[str, str]:
    """Things that are there, so that not all ids are unknown; and all that readiness asks for."""
    service.settings.models_dir.mkdir(parents=True)
    (service.settings.models_dir / "movenet-multipose.onnx").touch()
    service.services.queue.ping = lambda: True  # type: ignore[method-assign]
    job_id = service.job_id()
    service.finish(job_id)
    return {"job_id": job_id, "session_id": service.client.get(f"/v1/jobs/{job_id}").json()["session_id"]}


@schema.parametrize()
@settings(
    max_examples=CASES_EACH,
    deadline=None,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
def test_contract_is_kept(case: schemathesis.Case[Any], service: Live, known: dict[str, str]) -> None:
    global cases  # noqa: PLW0603
    cases += 1
    if cases % 2 and case.method != "DELETE":
        case.path_parameters.update({name: known[name] for name in case.path_parameters if name in known})
    # Schemathesis gives all files of a form one name, which no schema can forbid and the service refuses.
    excluded: list[Any] = [positive_data_acceptance] if case.media_type == "multipart/form-data" else []
    case.call_and_validate(base_url=str(service.client.base_url), excluded_checks=excluded)


def test_contract_was_tried_often_enough() -> None:
    assert cases >= 300
