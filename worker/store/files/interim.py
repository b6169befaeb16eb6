"""Interim outputs of chunks: files of a job alone, which are removed when the job ends.

No row names them, so they are in no backup. A file begins with the SHA-256 of the output.
"""

import hashlib

from worker.store.errors import NotFound
from worker.store.files.artifacts import ArtifactStore, interim_key, read_artifact
from worker.store.model.work import Claim

_DIGEST_BYTES = hashlib.sha256().digest_size


def write_interim(artifacts: ArtifactStore, claim: Claim, content: bytes) -> None:
    """Store the interim output of a claimed chunk."""
    stored = hashlib.sha256(content).digest() + content
    artifacts.put_bytes(interim_key(claim.job_id, claim.job_attempt, claim.output_key), stored)


def read_interim(artifacts: ArtifactStore, claim: Claim, output_key: str) -> bytes | None:
    """Read the interim output of a chunk of the claim's job by the key of the chunk's output.

    ``None`` if it is missing or damaged.
    """
    try:
        stored = read_artifact(artifacts, interim_key(claim.job_id, claim.job_attempt, output_key), None)
    except NotFound:
        return None
    content = stored[_DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == stored[:_DIGEST_BYTES] else None
