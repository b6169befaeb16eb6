"""Every code that the sources raise is documented, and every documented code is raised."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from api.contract.problem_codes import GROUPS, STATUSES, ProblemCode
from api.contract.problem_codes.page import PAGE, document, main
from api.errors import _CODES
from api.http.bodies.form_kinds import VIEWS
from pipeline.config import FILE_FORMATS

ROOT = Path(__file__).parents[3]
Function = ast.FunctionDef | ast.AsyncFunctionDef

CODES = {one.name: one for group in GROUPS for one in group.codes}
NAME = re.compile(r"[a-z]+(_[a-z0-9]+)*")
PLACES = {"job", "waiting", "attempt", "readyz", "command", "warning", "finding"}

# Functions with tuples whose first items are codes.
IN_TUPLES = {
    "api/sessions/form.py": {"_session_faults"},
    "api/jobs/spec_checks.py": {"callback_errors"},
    "api/cli/commands/backup.py": {"_code_and_faults"},
    "pipeline/capture/session.py": {"_range_problems"},
    "pipeline/quality/capture_checks.py": None,
    "pipeline/quality/world_checks.py": {
        f"_check_{what}" for what in ("upright", "floor", "statures", "cameras", "handedness", "pairs")
    },
}
# Functions that get their codes from a caller or a mapping; the codes are found there.
PASSED_ON = {
    ("api/http/bodies/form.py", "form"),  # those of FormKind.faults
    ("api/jobs/spec_checks.py", "spec_errors"),  # those of rules
    ("pipeline/rules.py", "value_faults"),  # those of requirements
    ("api/jobs/spec_checks.py", "callback_errors"),
    ("api/http/bodies/validation.py", "_parameter_items"),  # those of _CODES and of validators
    ("api/http/bodies/validation.py", "_items"),
    ("api/errors.py", "_from_status"),  # those of _CODES
    ("api/errors.py", "problem_response"),
    ("api/people/routes.py", "edit_job_people"),  # those of edits
    ("api/health/routes.py", "_database_check"),  # that of database_damaged
    ("api/calibrations/intake.py", "_point_errors"),  # those of known points
    ("api/people/routes.py", "edit_job_people"),  # that of apply_edits
    ("pipeline/capture/session.py", "_range_problems"),
    ("pipeline/findings.py", "from_problem"),  # those of the problem
    ("pipeline/quality/report.py", "all_checks"),  # those of the checks of a take
    ("pipeline/stages/calibrate.py", "calibrate"),  # those of problems
    ("pipeline/capture/session.py", "_of_video"),  # those of problems
    ("pipeline/video/info.py", "problem"),
    ("api/sessions/receiving.py", "adopted"),  # that of upload_elsewhere
    ("worker/problems.py", "waiting_for"),  # those of outages
    ("worker/problems.py", "problem_of"),  # those of the pipeline
}
# Codes that are composed of values that no call states as a constant.
TEMPLATES = {
    "unknown_{noun}": {"unknown_clock", "unknown_units"},
    "too_long_for_{export}": {f"too_long_for_{name}" for name, one in FILE_FORMATS.items() if one.max_frames},
    "invalid_{field}": {
        f"invalid_{field}" for field in ("name", "size", "matrix", "distortion", "rotation", "translation")
    },
    "too_many_{part}": {f"too_many_{part}" for part in VIEWS},
}


@cache
def sources() -> dict[str, ast.Module]:
    paths = [path for package in ("api", "pipeline", "worker") for path in (ROOT / package).rglob("*.py")]
    trees = {path.relative_to(ROOT).as_posix(): ast.parse(path.read_text("utf-8")) for path in paths}
    return {path: tree for path, tree in trees.items() if not path.startswith("api/contract/problem_codes/")}


def parameters(node: Function | ast.ClassDef) -> list[str]:
    """Names of the positional arguments of a call."""
    if isinstance(node, ast.ClassDef):
        constructor = [one for one in node.body if isinstance(one, Function) and one.name == "__init__"]
        if constructor:
            return parameters(constructor[0])
        fields = [one for one in node.body if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)]
        return [
            one.target.id
            for one in fields
            if isinstance(one.target, ast.Name) and "ClassVar" not in ast.unparse(one.annotation)
        ]
    names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return names[1:] if names[:1] == ["self"] else names


def functions(tree: ast.AST) -> Iterator[tuple[Function | None, ast.AST]]:
    """Every node with the innermost function that contains it."""

    def walk(node: ast.AST, owner: Function | None) -> Iterator[tuple[Function | None, ast.AST]]:
        for child in ast.iter_child_nodes(node):
            inner = child if isinstance(child, Function) else owner
            yield owner, child
            yield from walk(child, inner)

    yield from walk(tree, None)


def name_of(call: ast.Call) -> str | None:
    match call.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
    return None


def argument(call: ast.Call, name: str, index: int) -> ast.expr | None:
    named = next((one.value for one in call.keywords if one.arg == name), None)
    return named or (call.args[index] if index < len(call.args) else None)


def constants(node: ast.expr | None) -> list[str] | None:
    """Possible texts of an expression; ``None`` if it is not constant."""
    match node:
        case ast.Constant(value=str() as text):
            return [text]
        case ast.IfExp(body=body, orelse=other):
            both = constants(body), constants(other)
            return None if None in both else [*(both[0] or ()), *(both[1] or ())]
    return None


@cache
def callables() -> dict[str, set[tuple[str, int]]]:
    """Parameters of all functions and classes, with their positions, by the callable's name."""
    found: dict[str, set[tuple[str, int]]] = {}
    for tree in sources().values():
        for node in ast.walk(tree):
            if isinstance(node, Function | ast.ClassDef) and node.name != "__init__":
                found.setdefault(node.name, set()).update((name, at) for at, name in enumerate(parameters(node)))
    return found


def passed(function: str, parameter: str, module: str) -> set[str]:
    """Constants that calls of a function pass to a parameter; fails on a call that passes something else."""
    texts = set()
    at = next(index for name, index in callables()[function] if name == parameter)
    # Other modules may have private functions of the same name.
    modules = {module: sources()[module]} if function.startswith("_") else sources()
    for path, tree in modules.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and name_of(node) == function:
                found = constants(argument(node, parameter, at))
                assert found is not None, f"{path}:{node.lineno} passes no constant to {function}"
                texts.update(found)
    return texts


def from_template(text: ast.JoinedStr, function: Function, module: str) -> set[str]:
    """Codes that an f-string with one name can produce."""
    template = ast.unparse(text)[2:-1]
    if template in TEMPLATES:
        return TEMPLATES[template]
    match = re.fullmatch(r"(\w*)\{(\w+)\}(\w*)", template)
    assert match is not None
    assert match[2] in parameters(function), f"{template} in {function.name}: add its codes to TEMPLATES"
    return {f"{match[1]}{one}{match[3]}" for one in passed(function.name, match[2], module)}


def codes_of_calls(path: str, tree: ast.Module) -> Iterator[str]:
    """Codes that are passed to parameters named `code`."""
    for function, node in functions(tree):
        if not isinstance(node, ast.Call):
            continue
        for parameter, at in callables().get(name_of(node) or "", ()):
            if parameter != "code":
                continue
            code = argument(node, parameter, at)
            if isinstance(code, ast.Constant) and not isinstance(code.value, str):
                continue  # a status
            if code is None:
                continue
            if isinstance(code, ast.JoinedStr):
                assert function is not None
                yield from from_template(code, function, path)
            elif (texts := constants(code)) is not None:
                yield from texts
            elif function is None or not (isinstance(code, ast.Name) and code.id in parameters(function)):
                name = function.name if function else ""
                assert (path, name) in PASSED_ON, f"{path}:{node.lineno} {ast.unparse(node)}"


def codes_in_tuples(path: str, tree: ast.Module) -> Iterator[str]:
    """Codes that are the first items of tuples, in the functions of ``IN_TUPLES``."""
    if path not in IN_TUPLES:
        return
    for function, node in functions(tree):
        wanted = IN_TUPLES[path]
        if isinstance(node, ast.Tuple) and node.elts and function and (wanted is None or function.name in wanted):
            yield from (text for text in constants(node.elts[0]) or () if NAME.fullmatch(text))


def codes_elsewhere(tree: ast.Module) -> Iterator[str]:
    """Codes of error classes, literal dictionaries, validators, and mappings of codes."""
    for node in ast.walk(tree):
        match node:
            case ast.ClassDef(body=body):
                for one in body:
                    if isinstance(one, ast.Assign | ast.AnnAssign):
                        target = one.targets[0] if isinstance(one, ast.Assign) else one.target
                        if ast.unparse(target) == "code":
                            yield from constants(one.value) or ()
            case ast.Dict(keys=keys, values=values):
                for key, value in zip(keys, values, strict=True):
                    if constants(key) == ["code"]:
                        yield from constants(value) or ()
            case ast.Call() if name_of(node) == "PydanticCustomError":
                yield from constants(node.args[0]) or ()
            case ast.AnnAssign(target=ast.Name(id="_CODES"), value=ast.Dict(values=values)):
                yield from (text for value in values for text in constants(value) or ())


@cache
def raised() -> frozenset[str]:
    return frozenset(
        code
        for path, tree in sources().items()
        for code in (*codes_of_calls(path, tree), *codes_in_tuples(path, tree), *codes_elsewhere(tree))
    )


def test_every_raised_code_is_documented() -> None:
    assert len(raised()) > 150
    assert sorted(raised() - CODES.keys()) == []


def test_every_documented_code_is_raised() -> None:
    # `api.http.bodies.validation` uses these by a constant or by default.
    by_constant = {"missing_field", "wrong_type", "invalid_value"}
    assert sorted(CODES.keys() - raised() - by_constant) == []


def test_codes_are_documented_once() -> None:
    names = [one.name for group in GROUPS for one in group.codes]
    assert sorted(names) == sorted(set(names))


@pytest.mark.parametrize("code", CODES.values(), ids=lambda one: one.name)
def test_entries_are_sentences_and_places(code: ProblemCode) -> None:
    assert NAME.fullmatch(code.name)
    assert code.meaning.endswith(".")
    assert code.remedy.endswith(".")
    assert "|" not in code.meaning + code.remedy
    assert code.where
    assert all(place in PLACES or re.fullmatch(r"4\d\d|5\d\d", place) for place in code.where)


def calls_of(function: str) -> Iterator[ast.Call]:
    for tree in sources().values():
        yield from (node for node in ast.walk(tree) if isinstance(node, ast.Call) and name_of(node) == function)


def test_statuses_are_those_of_the_answers() -> None:
    raised_codes = {code for call in calls_of("ApiError") for code in constants(call.args[0]) or ()}
    assert len(raised_codes) > 30
    assert sorted(raised_codes - STATUSES.keys()) == []
    away = {code for call in calls_of("service_away") for code in constants(call.args[0]) or ()}
    assert {code: STATUSES[code] for code in away} == dict.fromkeys(away, 503)
    of_frameworks = {code: status for status, code in _CODES.items()}
    assert {code: STATUSES[code] for code in of_frameworks} == of_frameworks


def test_other_statuses_of_a_code_are_documented() -> None:
    stated = {
        (code, status.value)
        for call in calls_of("ApiError")
        if isinstance(status := argument(call, "status", 99), ast.Constant)
        for code in constants(call.args[0]) or ()
    }
    assert stated == {("quota_exceeded", 429)}
    assert all(status in CODES[code].statuses for code, status in stated)


def test_page_is_what_the_code_says(capsys: pytest.CaptureFixture[str]) -> None:
    assert PAGE.read_text(encoding="utf-8") == document()
    assert main(["--check"]) == 0
    assert capsys.readouterr().err == ""
