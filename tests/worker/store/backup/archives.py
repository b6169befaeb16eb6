"""Archives of backups as they are read, and as they may be forged."""

import io
import tarfile
from collections.abc import Callable
from pathlib import Path

from worker.store.backup.archive import ArchiveWriter, BackupError
from worker.store.errors import UnknownSchema


def attempt(action: Callable[[], object]) -> tuple[str, ...]:
    """Sentences of a refusal; empty if there was none."""
    try:
        action()
    except (BackupError, UnknownSchema) as error:
        return error.faults if isinstance(error, BackupError) else (str(error),)
    return ()


def members(archive: Path) -> list[tuple[str, bytes]]:
    with tarfile.open(archive) as opened:
        return [(one.name, opened.extractfile(one).read()) for one in opened if one.name != "SHA256SUMS"]  # type: ignore[union-attr]


def forged(path: Path, parts: list[tuple[str, bytes]]) -> Path:
    with path.open("wb") as file:
        writer = ArchiveWriter(file, 0, lambda _: None)
        for name, content in parts:
            writer.add(name, len(content), io.BytesIO(content))
        writer.finish()
    return path
