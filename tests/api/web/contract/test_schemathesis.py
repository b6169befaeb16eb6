"""Requests generated from the contract, valid and invalid: every response must conform to the contract."""

import contextlib
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.errors import FlakyStrategyDefinition, Unsatisfiable
from hypothesis.internal.conjecture import providers
from hypothesis.internal.constants_ast import Constants
from hypothesis.stateful import run_state_machine_as_test
from schemathesis import GenerationMode
from schemathesis.core.result import Ok
from schemathesis.specs.openapi.checks import (
    negative_data_rejection,
    positive_data_acceptance,
    response_schema_conformance,
)

from api.web.contract.openapi import COMMITTED
from api.web.settings import KIB, Settings
from api.web.uploads.routes import PIECE_TYPE
from pipeline.core.options.config import NETWORKS, NETWORKS_OF_PROFILES
from pipeline.core.options.file_formats import FILE_FORMATS
from tests.api.conftest import Live, running
from worker.run.presence import Presence, process_name
from worker.store.model.rights import Scope
from worker.store.model.work import WorkerState, WorkerStatus

schemathesis.serializer.alias(PIECE_TYPE, "application/octet-stream")
schema = schemathesis.openapi.from_path(COMMITTED)
# All calls have a valid key; Schemathesis checks calls without one in addition.
schema.config.generation.update(with_security_parameters=False)
# A body that is wrong and too large is refused for its size.
schema.config.checks.negative_data_rejection.expected_statuses.append("413")
INTAKES = {"/v1/calibrations", "/v1/characters", "/v1/jobs", "/v1/sessions"}
# Processes among which the operations are shared out.
PARTS = 3
SETTINGS = settings(
    max_examples=12,
    deadline=None,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)


@pytest.fixture(autouse=True)
def no_constants_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep literals of our modules out of the requests, which any change of the code would change."""
    monkeypatch.setattr(providers, "_get_local_constants", Constants)


@pytest.fixture(scope="module")
def service(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Service with a key of all scopes, and with limits so high that generated requests do not meet them first."""
    with running(make_settings(max_json_bytes=64 * KIB, max_wrong_keys_per_minute=1_000_000)) as live:
        _, secret = live.services.store.keys.add("default", "test", frozenset(Scope))
        live.client.headers["Authorization"] = f"Bearer {secret}"
        yield live


@pytest.fixture(scope="module")
def known(service: Live) -> Iterator[dict[str, str]]:
    """Ids of an existing session, job and upload, so that not all ids are unknown; the service is ready."""
    installed = (*NETWORKS, *NETWORKS_OF_PROFILES)
    worker = WorkerStatus(
        process_name(),
        WorkerState.READY,
        "A worker works",
        detectors=installed,
        bodies=("human",),
        formats=tuple(FILE_FORMATS),
    )
    workers = service.services.store.workers
    workers.report(worker)  # the thread's first report may come after the first request
    presence = Presence(workers, lambda: worker)
    presence.start()
    service.services.queue.ping = lambda: True  # type: ignore[method-assign]
    job_id = service.job_id()
    service.finish(job_id)
    assert service.client.get("/readyz").status_code == 200
    yield {"job_id": job_id, "session_id": service.client.get(f"/v1/jobs/{job_id}").json()["session_id"]}
    presence.stop()


def key_of(service: Live) -> dict[str, str]:
    return {"Authorization": service.client.headers["Authorization"]}


def inapplicable_checks(case: schemathesis.Case[Any]) -> list[Any]:
    """Checks that do not apply, because a schema can't express the rule."""
    if case.media_type == "multipart/form-data":
        # Schemathesis gives all files of a form one name, which the service refuses, and sends a number as its digits,
        # which are a file like any other.
        return [positive_data_acceptance, negative_data_rejection]
    if case.path.endswith("/events"):
        # Schemathesis compares the fields of each event with the schema, which declares a stream as text.
        return [response_schema_conformance]
    # tus has its own statuses for missing headers.
    if case.path.startswith("/v1/uploads"):
        return [positive_data_acceptance, negative_data_rejection]
    # A schema can't express which uploads exist, earlier uses of an idempotency key, or versions of a record.
    names_others = case.method == "POST" and case.path.removesuffix("/from-uploads") in INTAKES
    # Nor which people and files a job has, which files a link may name, and what a take is calibrated from.
    named = ("/links", "/edits", "/files", "/session", "/calibration")
    names_others = names_others or (case.method in {"POST", "PUT"} and case.path.endswith(named))
    # Nor the service's limit of a recording's lifetime.
    names_others = names_others or (case.method == "POST" and case.path == "/v1/recordings")
    if names_others or {"idempotency-key", "if-match"} & {name.lower() for name in case.headers}:
        return [positive_data_acceptance]
    # A schema can't express limits by the session's frames, the public addresses of webhooks, installed networks, or
    # Unicode's control characters.
    asks_more = isinstance(case.body, dict) and (
        str(case.body.get("detector")).startswith("own-")
        or case.body.get("smoothing") == "butterworth"
        or case.body.get("frame_range") is not None
        or case.body.get("callback_url") is not None
        or case.body.get("character") is not None
        or any(unicodedata.category(letter).startswith("C") for letter in str(case.body.get("name")))
    )
    return [positive_data_acceptance] if asks_more else []


@pytest.mark.parametrize(
    "part", [pytest.param(part, marks=pytest.mark.xdist_group(f"contract {part}")) for part in range(PARTS)]
)
def test_contract_is_kept(service: Live, known: dict[str, str], part: int) -> None:
    cases = 0

    def check(case: schemathesis.Case[Any]) -> None:
        nonlocal cases
        cases += 1
        excluded = inapplicable_checks(case)
        if not case.headers.get("content-length", "0").isdecimal():
            # Not a request by HTTP: the server refuses it before the service sees it.
            del case.headers["content-length"]
        if cases % 2 and case.method != "DELETE":
            ids = {name: known[name] for name in case.path_parameters if name in known}
            case.path_parameters.update(ids)
            if ids and case.method == "GET":  # the id may have been the only fault
                excluded = [*excluded, negative_data_rejection]
        case.call_and_validate(base_url=str(service.client.base_url), headers=key_of(service), excluded_checks=excluded)

    operations = list(schema.get_all_operations())[part::PARTS]
    for operation in operations:
        assert isinstance(operation, Ok)
        for mode in GenerationMode:
            with contextlib.suppress(Unsatisfiable):  # some operations have no parameter that can be invalid
                SETTINGS(given(operation.ok().as_strategy(generation_mode=mode))(check))()
    assert cases >= 1000 / PARTS


def test_calls_that_follow_from_each_other(service: Live, known: dict[str, str]) -> None:
    """Ids of responses are used in further calls, for example to read deleted jobs and to retry canceled jobs."""
    # The stream of a job without workers does not end, and generated files of a form are not a session.
    sent = [
        f"create{what}{way}"
        for what in ("Calibration", "Character", "Session", "SessionAndJob")
        for way in ("", "FromFiles")
    ]
    followed = schema.exclude(operation_id=["streamJobEvents", *sent])
    calls: Counter[str] = Counter()
    reached = {"POST /v1/jobs/{job_id}/cancel", "POST /v1/jobs/{job_id}/retry", "DELETE /v1/jobs/{job_id}"}

    class Workflow(followed.as_state_machine()):  # type: ignore[misc]
        def setup(self) -> None:
            service.job_id()

        def get_call_kwargs(self, case: schemathesis.Case[Any]) -> dict[str, Any]:
            return {"base_url": str(service.client.base_url), "headers": key_of(service)}

        def validate_response(self, response: Any, case: schemathesis.Case[Any], **options: Any) -> None:
            calls[f"{case.method} {case.path}"] += 1
            case.validate_response(response, excluded_checks=inapplicable_checks(case))

    few = settings(SETTINGS, max_examples=20, stateful_step_count=12, phases=[Phase.generate])
    for number in range(24):
        # Responses depend on earlier examples; Hypothesis reports this as flaky when it repeats a part of an example.
        with contextlib.suppress(FlakyStrategyDefinition):
            run_state_machine_as_test(seed(number)(Workflow), settings=few)
        if sum(calls.values()) >= 300 and set(calls) >= reached:
            break
    assert sum(calls.values()) >= 300
    assert set(calls) >= reached
