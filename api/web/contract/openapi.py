"""``python -m api.web.contract.openapi``: write the files in ``openapi/``, or compare them with the code (``--check``).

``openapi.json`` is the contract, ``live.asyncapi.json`` that of the WebSocket of live captures,
``recordings.asyncapi.json`` that of recordings by phones; ``examples/`` holds requests and responses of each operation.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from api.web.app import create_app
from api.web.contract import examples
from api.web.live.asyncapi import describe_live
from api.web.recordings.asyncapi import describe_recordings
from api.web.resources import RESOURCES
from api.web.settings import Settings

FOLDER = Path(__file__).parents[3] / "openapi"
COMMITTED = FOLDER / "openapi.json"
LIVE = FOLDER / "live.asyncapi.json"
RECORDINGS = FOLDER / "recordings.asyncapi.json"

_METHODS = ("get", "head", "options", "post", "patch", "delete")


def document() -> str:
    """Content of ``openapi.json``."""
    return _text(create_app(Settings()).openapi())


def documents() -> dict[Path, str]:
    """Contents of all files by path."""
    contract = json.loads(document())
    exchanges = {FOLDER / "examples" / f"{name}.json": _text(exchange) for name, exchange in _exchanges(contract)}
    sockets = {LIVE: _text(describe_live()), RECORDINGS: _text(describe_recordings())}
    return {COMMITTED: document(), **sockets, **exchanges}


def _text(value: object) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False) + "\n"


def _exchanges(contract: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name of each operation with example requests and successful responses."""
    for path, item in contract["paths"].items():
        for method in _METHODS:
            if method not in item:
                continue
            operation = item[method]
            yield (
                operation["operationId"],
                {
                    "summary": operation["description"],
                    "requests": list(_requests(method, path, operation)),
                    "answers": list(_answers(contract, operation)),
                },
            )


def _requests(method: str, path: str, operation: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Example requests of an operation, one for each accepted content type."""
    for resource in RESOURCES:
        for name, value in resource.parameters.items():
            path = path.replace(f"{{{name}}}", str(value))
    parameters = operation.get("parameters", ())
    named = {parameter["name"].lower() for parameter in parameters if parameter["in"] == "header"}
    headers = {name: value for name, value in examples.REQUEST_HEADERS.items() if name.lower() in named}
    if operation.get("security"):
        headers = {"Authorization": "Bearer mc_...", **headers}
    line = {"method": method.upper(), "path": path}
    contents = operation.get("requestBody", {"content": {}})["content"]
    for content_type, content in contents.items():
        yield {**line, "headers": headers | {"Content-Type": content_type}, "body": _example(content)}
    if not contents:
        yield {**line, "headers": headers}


def _answers(contract: Mapping[str, Any], operation: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for status, answer in operation["responses"].items():
        if "$ref" in answer:  # a problem, which is shared by all operations
            continue
        declared = answer.get("headers", {})
        headers = {name: header.get("example", examples.ANSWER_HEADERS.get(name)) for name, header in declared.items()}
        line = {"status": int(status), "headers": headers}
        for content_type, content in answer.get("content", {}).items():
            body = _example(content)
            if isinstance(body, dict) and "$ref" in body:
                body = contract["components"]["examples"][body["$ref"].rpartition("/")[2]]["value"]
            yield {**line, "headers": headers | {"Content-Type": content_type}, "body": body}
        if not answer.get("content"):
            yield line


def _example(content: Mapping[str, Any]) -> Any:
    if "example" in content:
        return content["example"]
    first = next(iter(content["examples"].values()))
    return first.get("value", first)


def main() -> int:
    """Write or compare the files, and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m api.web.contract.openapi", description="Write the contract of the web API to openapi/."
    )
    parser.add_argument("--check", action="store_true", help="Compare with the files; exit with 1 if they differ.")
    present = set(FOLDER.rglob("*.json"))
    texts = documents()
    if not parser.parse_args().check:
        for path in present - texts.keys():
            path.unlink()
        for path, text in texts.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        return 0
    if present == texts.keys() and all(path.read_text(encoding="utf-8") == text for path, text in texts.items()):
        return 0
    sys.stderr.write("openapi/ differs from the code. Run: python -m api.web.contract.openapi\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
