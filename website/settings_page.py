"""Page ``docs/reference/settings.md``: settings of the service with their values, defaults and meanings."""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic.fields import FieldInfo
from pydantic_settings import BaseSettings

from api.web.settings import GIB, KIB, MIB, Settings
from pipeline.core.options.requirements import Schema, requirement
from worker.run.settings import SharedSettings, WorkerSettings

SECTIONS: Mapping[str, str] = {
    "signed_downloads_s": "API: addresses and encryption",
    "max_file_bytes": "API: sizes of captures",
    "max_tenant_sessions": "API: limits of tenants and clients",
    "shared_uploads": "API: uploads, results and chunks",
    "preflight_command": "API: checks of captures",
    "live_command": "API: live captures",
    "public_url": "API: recordings by phones",
}
"""Titles of the sections of the API's settings, by the first setting of each."""

_INTRODUCTION = """\
# Settings

This page lists every setting of the service: its environment variable, its values, its default and its meaning.

- `multicap serve` and the commands that open its data read the same variables as the single programs. Options of
  commands, such as `--data`, replace the variables.
- A variable with `_FILE` at its end names a file that holds the value, such as a container's secret:
  `MULTICAP_DATABASE_URL_FILE=/run/secrets/database_url`. A variable and its file at once are refused. Messages never
  show what a file holds.
- Sizes are whole numbers of bytes: 1 MiB is 1048576, 1 GiB is 1073741824. Lists are JSON.
- A wrong value ends the program at its start, with a sentence for each wrong variable:

```
$ MULTICAP_PORT=abc multicap serve
error MULTICAP_PORT=abc: must be a whole number from 0 to 65535.
```

The default is `-` where the meaning says what happens without the variable.
"""
_OTHERS = """\
## Other variables

| variable | meaning |
| --- | --- |
| `MULTICAP_HOME` | Folder of networks, compiled kernels and samples. Without it the user's data folder. |
| `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_SESSION_TOKEN` | Keys of the bucket, also with `_FILE`. |
| `AWS_ENDPOINT_URL`, `AWS_REGION` | Address of an S3 server other than Amazon's; region. |
| `OTEL_EXPORTER_OTLP_ENDPOINT` | Address for traces by OTLP over HTTP; without it none are made. |
"""
_HEAD = ("", "| variable | values | default | meaning |", "| --- | --- | --- | --- |")
_UNITS = ((GIB, "GiB"), (MIB, "MiB"), (KIB, "KiB"))
_VARIABLE = "MULTICAP_"


def document() -> str:
    """Write the page as Markdown."""
    shared = SharedSettings.model_fields
    lines = [_INTRODUCTION, "## All programs", *_table(SharedSettings, shared), ""]
    sections: dict[str, list[str]] = {}
    for name in Settings.model_fields:
        if name not in shared:
            sections.setdefault(SECTIONS.get(name) or next(reversed(sections)), []).append(name)
    for title, names in sections.items():
        lines += [f"## {title}", *_table(Settings, names), ""]
    lines += ["## Workers and reaper"]
    lines += [*_table(WorkerSettings, [name for name in WorkerSettings.model_fields if name not in shared]), ""]
    return "\n".join([*lines, _OTHERS])


def _table(kind: type[BaseSettings], names: Iterable[str]) -> Iterator[str]:
    """Lines of a table with a row for each setting."""
    root = kind.model_json_schema()
    yield from _HEAD
    for name in names:
        field = kind.model_fields[name]
        cells = (f"`{variable(name)}`", _values(root, name), _default(name, field), _meaning(field))
        yield f"| {' | '.join(cells)} |"


def variable(name: str) -> str:
    """Environment variable of a setting.

    >>> variable("data_dir")
    'MULTICAP_DATA_DIR'
    """
    return f"{_VARIABLE}{name.upper()}"


def _values(root: Schema, name: str) -> str:
    return requirement(root["properties"][name], root, null=False).replace("|", "\\|")


def _default(name: str, field: FieldInfo) -> str:
    value: Any = field.default
    if field.default_factory is not None or value is None or value == "":
        return "-"
    match value:
        case bool():
            return f"`{str(value).lower()}`"
        case int() | float():
            return _size(int(value)) if name.endswith("_bytes") else f"`{value:.15g}`"
        case tuple():
            return "Multicap's own"
        case frozenset():
            return "`[]`"
    return f"`{value}`"


def _size(num_bytes: int) -> str:
    """Size with the largest unit that needs at most one decimal place."""
    for unit, word in _UNITS:
        if num_bytes >= unit and num_bytes * 10 % unit == 0:
            return f"{num_bytes / unit:g} {word}"
    return str(num_bytes)


def _meaning(field: FieldInfo) -> str:
    """Description of a setting, with other settings by their variables."""
    names = {*Settings.model_fields, *WorkerSettings.model_fields}
    return re.sub(
        r"\b[a-z]+(?:_[a-z]+)+\b",
        lambda word: f"`{variable(word[0])}`" if word[0] in names else word[0],
        " ".join(str(field.description).split()),
    )
