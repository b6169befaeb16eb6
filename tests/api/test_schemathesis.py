"""Requests made from the contract, right and wrong ones: no answer may be one that the contract does not know."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from schemathesis.core.result import Ok
from schemathesis.specs.openapi.checks import negative_data_rejection, positive_data_acceptance

from api.openapi import COMMITTED
from api.settings import KIB, Settings
from tests.api.conftest import Live, running

schema = schemathesis.openapi.from_path(COMMITTED)
SETTINGS = settings(
    max_examples=30,
    deadline=None,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)


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


def test_contract_is_kept(service: Live, known: dict[str, str]) -> None:
    cases = 0

    def check(case: schemathesis.Case[Any]) -> None:
        nonlocal cases
        cases += 1
        if cases % 2 and case.method != "DELETE":
            case.path_parameters.update({name: known[name] for name in case.path_parameters if name in known})
        # Schemathesis gives all files of a form one name, which the service refuses, and sends a number as its digits,
        # which are a file like any other.
        is_form = case.media_type == "multipart/form-data"
        excluded: list[Any] = [positive_data_acceptance, negative_data_rejection] if is_form else []
        # Which cutoff a session's frame rate allows, no schema can say.
        if isinstance(case.body, dict) and case.body.get("smoothing") == "butterworth":
            excluded.append(positive_data_acceptance)
        case.call_and_validate(base_url=str(service.client.base_url), excluded_checks=excluded)

    for operation in schema.get_all_operations():
        assert isinstance(operation, Ok)
        for mode in GenerationMode:
            with contextlib.suppress(Unsatisfiable):  # there are operations with nothing that could be wrong
                SETTINGS(given(operation.ok().as_strategy(generation_mode=mode))(check))()
    assert cases >= 300
