"""``python -m api.contract.openapi``: write what is in ``openapi/``, or with ``--check`` compare it with the code.

``openapi.json`` is the contract; ``examples/`` holds an exchange of each operation, as a client sends and gets it.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from api.app import create_app
from api.contract import examples
from api.settings import Settings

FOLDER = Path(__file__).parents[2] / "openapi"
COMMITTED = FOLDER / "openapi.json"

_METHODS = ("get", "head", "options", "post", "patch", "delete")


def document() -> str:
    """The contract as the file holds it."""
    return _text(create_app(Settings()).openapi())


def documents() -> dict[Path, str]:
    """All files, with what they hold."""
    contract = json.loads(document())
    exchanges = {FOLDER / "examples" / f"{name}.json": _text(found) for name, found in _exchanges(contract)}
    return {COMMITTED: document(), **exchanges}


def _text(value: object) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False) + "\n"


def _exchanges(contract: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every operation's name, with its requests and what is answered when all is well."""
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
    """One of each type of content that is taken."""
    for name, value in examples.PATH_PARAMETERS.items():
        path = path.replace(f"{{{name}}}", value)
    named = {one["name"].lower() for one in operation.get("parameters", ()) if one["in"] == "header"}
    headers = {name: value for name, value in examples.REQUEST_HEADERS.items() if name.lower() in named}
    if operation.get("security"):
        headers = {"Authorization": "Bearer mc_...", **headers}
    said = {"method": method.upper(), "path": path}
    contents = operation.get("requestBody", {"content": {}})["content"]
    for content_type, content in contents.items():
        yield {**said, "headers": headers | {"Content-Type": content_type}, "body": _example(content)}
    if not contents:
        yield {**said, "headers": headers}


def _answers(contract: Mapping[str, Any], operation: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for status, answer in operation["responses"].items():
        if "$ref" in answer:  # a problem, which all operations share
            continue
        declared = answer.get("headers", {})
        headers = {name: one.get("example", examples.ANSWER_HEADERS.get(name)) for name, one in declared.items()}
        said = {"status": int(status), "headers": headers}
        for content_type, content in answer.get("content", {}).items():
            body = _example(content)
            if isinstance(body, dict) and "$ref" in body:
                body = contract["components"]["examples"][body["$ref"].rpartition("/")[2]]["value"]
            yield {**said, "headers": headers | {"Content-Type": content_type}, "body": body}
        if not answer.get("content"):
            yield said


def _example(content: Mapping[str, Any]) -> Any:
    if "example" in content:
        return content["example"]
    first = next(iter(content["examples"].values()))
    return first.get("value", first)


def main() -> int:
    """Write or compare, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m api.contract.openapi", description="The API's contract as files.")
    parser.add_argument("--check", action="store_true", help="Compare with the files; 1 if they differ.")
    found = set(FOLDER.rglob("*.json"))
    wanted = documents()
    if not parser.parse_args().check:
        for path in found - wanted.keys():
            path.unlink()
        for path, text in wanted.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        return 0
    if found == wanted.keys() and all(path.read_text(encoding="utf-8") == text for path, text in wanted.items()):
        return 0
    sys.stderr.write("openapi/ is not what the code says. Run: python -m api.contract.openapi\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
