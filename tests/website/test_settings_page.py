"""Page of the settings: every setting has a row with its default, and a description that says what happens without."""

import re

import pytest
from pydantic_settings import BaseSettings

from api.web.settings import Settings
from website.settings_page import SECTIONS, document, variable
from worker.run.settings import SharedSettings, WorkerSettings

KINDS = (Settings, WorkerSettings)
FIELDS = [(kind, name) for kind in KINDS for name in kind.model_fields]
UNITS = {"KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
ROWS = dict(re.findall(r"^\| `(MULTICAP_\w+)` \| (.*) \|$", document(), re.MULTILINE))


@pytest.mark.parametrize(("kind", "name"), FIELDS, ids=[f"{kind.__name__}-{name}" for kind, name in FIELDS])
def test_every_setting_is_described(kind: type[BaseSettings], name: str) -> None:
    field = kind.model_fields[name]
    assert field.description is not None
    assert field.description.endswith(".")
    # A setting without a value: the description says what happens then.
    if field.default_factory is not None or field.default in {None, ""}:
        assert re.search(r"[Ww]ithout it|Default: |needed with", " ".join(field.description.split()))
    assert variable(name) in ROWS


def test_settings_have_one_row_each() -> None:
    variables = re.findall(r"^\| `(MULTICAP_\w+)`", document(), re.MULTILINE)
    assert sorted(variables) == sorted({*(variable(name) for _, name in FIELDS), "MULTICAP_HOME"})
    # Both kinds have the settings of their base alone in common.
    assert {*Settings.model_fields} & {*WorkerSettings.model_fields} == {*SharedSettings.model_fields}


@pytest.mark.parametrize(("kind", "name"), FIELDS, ids=[f"{kind.__name__}-{name}" for kind, name in FIELDS])
def test_rows_have_defaults_of_settings(kind: type[BaseSettings], name: str) -> None:
    field = kind.model_fields[name]
    _, shown, _ = ROWS[variable(name)].split(" | ", maxsplit=2)
    if isinstance(field.default, int | float) and not isinstance(field.default, bool):
        number, _, unit = shown.strip("`").partition(" ")
        assert float(number) * UNITS.get(unit, 1) == field.default


def test_rows_have_values_and_variables_of_other_settings() -> None:
    assert ROWS["MULTICAP_PORT"].startswith("a whole number from 0 to 65535 | `8000` | ")
    assert ROWS["MULTICAP_MEMORY_BYTES"].split(" | ")[1] == "3.5 GiB"
    assert "checked from `MULTICAP_CLIENT_IDLE_S` on" in ROWS["MULTICAP_CLIENT_MIN_BYTES_PER_S"]


def test_sections_begin_with_settings() -> None:
    own = [name for name in Settings.model_fields if name not in SharedSettings.model_fields]
    assert own[0] == next(iter(SECTIONS))
    assert [name for name in own if name in SECTIONS] == [*SECTIONS]
