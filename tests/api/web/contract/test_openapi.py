"""OpenAPI document: committed file, operations, examples, security and schemas."""

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from jsonschema_rs import validator_for

from api.web.contract.openapi import COMMITTED, document
from api.web.live.schemas import describe_live
from api.web.recordings.messages import describe_recordings
from pipeline.core.options.file_formats import FILE_FORMATS
from tests.api.conftest import Live

METHODS = {"get", "head", "options", "post", "put", "patch", "delete"}


def operations(schema: dict[str, Any]) -> list[dict[str, Any]]:
    return [operation for path in schema["paths"].values() for name, operation in path.items() if name in METHODS]


@pytest.fixture
def schema(live: Live) -> dict[str, Any]:
    found: dict[str, Any] = live.client.get("/openapi.json").json()
    return found


def test_committed_contract_is_what_code_says() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == document(), "Run: python -P -m api.web.contract.openapi"


def test_operations_have_examples_that_keep_contract(schema: dict[str, Any]) -> None:
    """Every body in JSON, of a request and of an answer, has an example of its schema."""
    for operation in operations(schema):
        bodies = [operation.get("requestBody", {}), *operation["responses"].values()]
        contents = [body.get("content", {}).get("application/json") for body in bodies]
        for content in filter(None, contents):
            if content["schema"].get("format") == "binary":
                continue
            examples = [content["example"]] if "example" in content else [*content["examples"].values()]
            assert examples
            for example in examples:
                found = (
                    schema["components"]["examples"][example["$ref"].rpartition("/")[2]]
                    if "$ref" in example
                    else example
                )
                validator_for(schema | content["schema"]).validate(found.get("value", found))


@pytest.mark.parametrize(("path", "describe"), [("live", describe_live), ("recordings", describe_recordings)])
def test_contracts_of_websockets_are_served(live: Live, path: str, describe: Callable[[], dict[str, Any]]) -> None:
    assert live.client.get(f"/{path}.asyncapi.json").raise_for_status().json() == describe()


def test_operations_are_named_and_explained(schema: dict[str, Any]) -> None:
    assert schema["openapi"].startswith("3.1")
    names = [operation["operationId"] for operation in operations(schema)]
    assert len(set(names)) == len(names) > 50
    assert all(re.fullmatch(r"[a-z]+([A-Z][a-z]+)+", name) for name in names)
    assert all(operation["description"] for operation in operations(schema))
    for operation in operations(schema):
        summary = operation["summary"]
        assert re.fullmatch(r"[A-Z][a-z]+ [a-z' ]+", summary), summary
    assert len({operation["summary"] for operation in operations(schema)}) == len(names)


@pytest.mark.parametrize("path", ["/v1/calibrations", "/v1/characters", "/v1/jobs", "/v1/sessions"])
def test_routes_with_two_bodies_have_operation_for_each(schema: dict[str, Any], path: str) -> None:
    """Generators of clients keep one body of an operation, or mix both."""
    content = schema["paths"][path]["post"]["requestBody"]["content"]
    assert len(content) == 2
    for way, content_type in (("from-files", "multipart/form-data"), ("from-uploads", "application/json")):
        operation = schema["paths"][f"{path}/{way}"]["post"]
        assert operation["requestBody"]["content"] == {content_type: content[content_type]}
        assert operation["responses"] == schema["paths"][path]["post"]["responses"]
    bodies = [operation["requestBody"]["content"] for operation in operations(schema) if "requestBody" in operation]
    assert sum(len(body) > 1 for body in bodies) == 4


def test_files_are_declared_as_bytes(schema: dict[str, Any]) -> None:
    """Else clients decode text, parse JSON, and write other bytes than came."""
    files = {
        "getAllResults", "getCalibrationFile", "getCharacterFile", "getMotion", "getResult", "getSampleFile",
        "getSessionThumbnail", "getSessionVideo",
    }  # fmt: skip
    contents = {
        operation["operationId"]: operation["responses"]["200"]["content"]
        for operation in operations(schema)
        if operation["operationId"] in files
    }
    assert contents.keys() == files
    for content in contents.values():
        for media_type, declared in content.items():
            assert declared["schema"]["format"] == "binary"
            assert declared["schema"].get("type") == (None if media_type == "application/json" else "string")
    # openapi-python-client reads the first type that it knows, and takes any other than this one for text or JSON.
    assert next(iter(contents["getResult"])) == "application/octet-stream"
    types = {one.media_type.partition(";")[0] for one in FILE_FORMATS.values()}
    assert types < contents["getResult"].keys()
    upload = schema["paths"]["/v1/uploads/{upload_id}"]["patch"]["requestBody"]["content"]
    assert upload["application/offset+octet-stream"]["schema"]["format"] == "binary"


def test_document_has_license_and_subject(schema: dict[str, Any]) -> None:
    assert schema["info"]["license"] == {"name": "Apache License 2.0", "identifier": "Apache-2.0"}
    assert schema["servers"] == [{"url": "/", "description": "Service that serves this document."}]
    described = {tag["name"] for tag in schema["tags"] if tag["description"]}
    assert described == {tag for operation in operations(schema) for tag in operation["tags"]}


def test_ways_to_authorize_are_declared(schema: dict[str, Any]) -> None:
    schemes = schema["components"]["securitySchemes"]
    assert {name: one["type"] for name, one in schemes.items()} == {
        "key": "http",
        "browser": "apiKey",
        "link": "apiKey",
    }
    used = {name for operation in operations(schema) for way in operation["security"] for name in way}
    assert used == schemes.keys()


def test_every_model_has_one_schema(schema: dict[str, Any]) -> None:
    """Generators of clients refuse two schemas with one title."""
    titles = [described["title"] for described in schema["components"]["schemas"].values() if "title" in described]
    assert len(titles) == len(set(titles)) > 50


def test_all_arrays_say_their_items(schema: dict[str, Any]) -> None:
    def arrays(node: Any) -> Iterator[dict[str, Any]]:
        if isinstance(node, dict):
            if node.get("type") == "array":
                yield node
            for value in node.values():
                yield from arrays(value)
        elif isinstance(node, list):
            for value in node:
                yield from arrays(value)

    found = [one for one in arrays(schema) if "default" not in one or "items" in one]
    assert len(found) > 10
    assert all("items" in one and "prefixItems" not in one for one in found)
    size = schema["components"]["schemas"]["CameraOut"]["properties"]["size_px"]
    assert (size["items"], size["minItems"], size["maxItems"]) == ({"type": "integer"}, 2, 2)


def test_operations_with_callbacks_declare_what_is_sent(schema: dict[str, Any]) -> None:
    message = {"$ref": "#/components/schemas/JobEnded"}
    pointers = {"/v1/sessions/{session_id}/jobs": "/callback_url"}
    pointers |= {f"/v1/jobs{way}": "/spec/callback_url" for way in ("", "/from-files", "/from-uploads")}
    for path, pointer in pointers.items():
        ((expression, item),) = schema["paths"][path]["post"]["callbacks"]["jobEnded"].items()
        assert expression == f"{{$request.body#{pointer}}}"
        assert item["post"]["requestBody"]["content"]["application/json"]["schema"] == message
    assert schema["webhooks"]["job-ended"]["post"]["requestBody"]["content"]["application/json"]["schema"] == message


def test_every_answer_has_example(schema: dict[str, Any]) -> None:
    for operation in operations(schema):
        for status, response in operation["responses"].items():
            if status in {"204", "304", "307"}:
                continue
            declared = (
                schema["components"]["responses"][response["$ref"].split("/")[-1]] if "$ref" in response else response
            )
            # Responses about uploads have headers only.
            for content in declared.get("content", {} if "uploads" in operation["tags"] else None).values():
                assert "example" in content or content["examples"], (operation["operationId"], status)


def test_every_body_has_example(schema: dict[str, Any]) -> None:
    for operation in operations(schema):
        for content in operation.get("requestBody", {"content": {}})["content"].values():
            assert "example" in content or content["examples"]


def test_every_operation_declares_its_errors(schema: dict[str, Any]) -> None:
    for operation in operations(schema):
        assert {"403", "500", "503"} <= operation["responses"].keys()
        if any(parameter["in"] == "query" for parameter in operation.get("parameters", [])):
            assert "422" in operation["responses"], operation["operationId"]
        if "{job_id}" in str(operation.get("parameters")) or operation["operationId"].startswith(("get", "delete")):
            assert "404" in operation["responses"] or operation["operationId"] in {
                "getCaller",
                "getHealth",
                "getMetrics",
                "getOptions",
                "getReadiness",
                "getSample",
            }


def test_examples_are_valid_and_complete(schema: dict[str, Any]) -> None:
    """A field of text without an example of its own would be shown as an ellipsis."""
    for model, example in schema["components"]["examples"].items():
        validator_for(schema | {"$ref": f"#/components/schemas/{model}"}).validate(example["value"])
        assert '"..."' not in json.dumps(example), model


def test_examples_of_problems_are_valid(schema: dict[str, Any]) -> None:
    validator = validator_for(schema | {"$ref": "#/components/schemas/ProblemDetails"})
    for status in operations(schema)[0]["responses"]:
        name = f"Problem{status}"
        if name in schema["components"]["responses"]:
            content = schema["components"]["responses"][name]["content"]["application/problem+json"]
            validator.validate(content["example"])
            assert content["example"]["status"] == int(status)
