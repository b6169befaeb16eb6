"""Folders for temporary files of a run."""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from pipeline.export.results import not_written

# How names of folders begin, beside the results, whose files are not whole, and the file that their processes lock.
_UNFINISHED, _LOCK = ".new-", "lock"


@contextlib.contextmanager
def scratch_folder(results: Path | None) -> Iterator[Path]:
    """Folder for temporary files during the block; in that of the results, if there is one, so that files are moved.

    Removes what killed processes left there. Raises ``PipelineError`` if the folder of the results can't be written.
    """
    if results is None:
        with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
            yield Path(folder)
        return
    is_new = not results.exists()
    with contextlib.ExitStack() as stack:
        try:
            results.mkdir(parents=True, exist_ok=True)
            if is_new:
                stack.callback(_remove_empty, results)
            scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=_UNFINISHED, dir=results)))
            stack.enter_context(FileLock(scratch / _LOCK, timeout=0))
        except OSError as error:
            raise not_written(results, error) from error
        _remove_left(results)
        yield scratch


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):  # it is not empty
        folder.rmdir()


def _remove_left(folder: Path) -> None:
    """Remove the folders for temporary files whose processes were killed: nobody holds their locks."""
    for left in folder.glob(f"{_UNFINISHED}*"):
        with contextlib.suppress(Timeout, OSError), FileLock(left / _LOCK, timeout=0):
            shutil.rmtree(left, ignore_errors=True)
