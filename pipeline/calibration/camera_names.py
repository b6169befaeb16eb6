"""Names of cameras: the rule of calibrations, which phones that become cameras keep too."""

from typing import Any

MAX_NAME_LENGTH = 64


def name_problem(name: Any) -> str | None:
    """End of a sentence about a wrong name of a camera, or ``None``."""
    if not isinstance(name, str) or not name.strip():
        return "is missing or not a text."
    if len(name) > MAX_NAME_LENGTH or not name.isprintable() or "/" in name or "\\" in name:
        return f"must be at most {MAX_NAME_LENGTH} printable characters without slashes."
    if name in {".", ".."}:  # names of folders that are there already
        return "must not be . or .."
    return None
