"""Record of a session's check: what the preflight found in the files, for the stages.

A NumPy archive without pickles, byte-identical for equal sessions, see ``core.runtime.record_archive``. It has all of
a session of keypoints or points, whose files are not needed again, and of videos' paths only the names.
"""

import hashlib
import io
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.points import PointSession
from pipeline.capture.session import CaptureSession, Session
from pipeline.core.runtime.record_archive import decode, write
from pipeline.video.info import VideoInfo


def save_record(session: Session, file: io.BufferedIOBase) -> None:
    """Write the record of a session of any kind into a file: in memory it would be as large as the session."""
    if isinstance(session, CaptureSession):
        session = replace(session, frames=None, whole_timebase=None)  # all output frames
    write(session, file)


def record_sha256(session: Session) -> str:
    """SHA-256 of the record of a session."""
    with tempfile.TemporaryFile() as file:
        save_record(session, file)
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


def decode_session(content: bytes | BinaryIO, folder: Path) -> CaptureSession:
    """Read a session of videos that ``save_record`` wrote; the videos are in ``folder`` by their names."""

    def placed(video: VideoInfo) -> VideoInfo:
        return replace(video, path=folder / video.path, parts=tuple(map(placed, video.parts)))

    session = decode(CaptureSession, content)
    return replace(session, videos=tuple(map(placed, session.videos)))


def decode_keypoints(content: bytes | BinaryIO) -> KeypointSession:
    """Read a session of keypoints that ``save_record`` wrote."""
    return decode(KeypointSession, content)


def decode_points(content: bytes | BinaryIO) -> PointSession:
    """Read a session of 3D points that ``save_record`` wrote."""
    return decode(PointSession, content)
