"""Part affinity fields of a session in files, so that memory does not grow with the session's length."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.data import PafFields
from pipeline.errors import PipelineError
from pipeline.stages.outputs_npz import decode_fields


class FieldFiles:
    """Files of the fields of all cameras, one a camera and range of output frames.

    Parameters
    ----------
    folder
        Empty folder for the files.
    cameras
        Names of the cameras.
    """

    def __init__(self, folder: Path, cameras: Sequence[str]) -> None:
        self._folder, self._cameras = folder, tuple(cameras)

    def write(self, camera: str, frames: range, fields: bytes) -> None:
        """Write the encoded fields of a camera's range.

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
        """Read the fields of all cameras for a range, by camera name."""
        return {camera: decode_fields(self._path(camera, frames).read_bytes()) for camera in self._cameras}

    def _path(self, camera: str, frames: range) -> Path:
        return self._folder / f"{self._cameras.index(camera)}-{frames.start}.npz"
