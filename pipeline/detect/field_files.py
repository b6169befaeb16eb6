"""Fields of a whole session on disk, since memory would grow with its length."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.data import PafFields
from pipeline.errors import PipelineError
from pipeline.stages.outputs_npz import decode_fields


class FieldFiles:
    """Fields of all cameras, range by range.

    Parameters
    ----------
    folder
        An empty one.
    cameras
        Names.
    """

    def __init__(self, folder: Path, cameras: Sequence[str]) -> None:
        self._folder, self._cameras = folder, tuple(cameras)

    def write(self, camera: str, frames: range, fields: bytes) -> None:
        """Keep the encoded fields of a camera's range.

        Raises
        ------
        PipelineError
            If the folder can't be written.
        """
        try:
            self._path(camera, frames).write_bytes(fields)
        except OSError as error:
            raise PipelineError(
                f"The part affinity fields can't be kept: {error.strerror}. Free some space in the folder for "
                "temporary files, or set TMPDIR to another."
            ) from error

    def read(self, frames: range) -> dict[str, PafFields]:
        """All cameras' fields of a range."""
        return {camera: decode_fields(self._path(camera, frames).read_bytes()) for camera in self._cameras}

    def _path(self, camera: str, frames: range) -> Path:
        return self._folder / f"{self._cameras.index(camera)}-{frames.start}.npz"
