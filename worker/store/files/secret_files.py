"""Values of environment variables that files hold: ``NAME_FILE`` names the file with the value of ``NAME``.

Passwords in the environment are seen by whoever may list processes or containers; files have modes and owners.
"""

import os
from pathlib import Path

# Keys of the bucket; S3's other variables are no secrets.
S3_KEYS = "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN"

# Longest value: keys and URLs are short, and a wrong path may lead to a video.
_MAX_BYTES = 64 * 2**10


class FileVariableError(ValueError):
    """A variable that names a file can't be used; the text is a sentence about it."""


def file_variable(name: str) -> str | None:
    """Value of a variable out of the file that ``name`` with ``_FILE`` names, without the newline at its end.

    ``None`` if no file is named. Raises ``FileVariableError`` if the file can't be read, is empty, is no text or is
    larger than 64 KiB, or if ``name`` is set too.
    """
    variable = f"{name}_FILE"
    path = os.environ.get(variable)
    if not path:
        return None
    if os.environ.get(name):
        raise FileVariableError(f"{name} and {variable} are both set: set one of them.")
    try:
        with Path(path).open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
        text = content.decode()
    except OSError as error:
        raise FileVariableError(f"{variable}={path}: the file can't be read ({error.strerror}).") from None
    except UnicodeDecodeError:
        raise FileVariableError(f"{variable}={path}: the file must hold text in UTF-8.") from None
    if len(content) > _MAX_BYTES:
        raise FileVariableError(f"{variable}={path}: the file is larger than {_MAX_BYTES // 2**10} KiB.")
    if not (value := text.removesuffix("\n").removesuffix("\r")):
        raise FileVariableError(f"{variable}={path}: the file is empty.")
    return value
