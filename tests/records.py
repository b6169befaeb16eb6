"""Records of sessions in memory, for tests."""

import io

from pipeline.capture.preflight_npz import save_record
from pipeline.capture.session import Session


def encode_record(session: Session) -> bytes:
    """Content of the file that ``save_record`` writes."""
    file = io.BytesIO()
    save_record(session, file)
    return file.getvalue()
