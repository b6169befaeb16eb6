"""Second workers of chunks that take long, memory of chunks and workers, and an index that has chunks in order."""

import sqlalchemy as sa
from alembic import op

revision = "0036"
down_revision = "0035"


def upgrade() -> None:
    """Add the columns; the memory of earlier chunks is unknown. Look for ready chunks in the order of their claims."""
    op.add_column("chunks", sa.Column("memory_bytes", sa.BigInteger, nullable=False, server_default="0"))
    op.add_column("chunks", sa.Column("copy_worker", sa.String))
    op.add_column("chunks", sa.Column("copy_token", sa.String(36)))
    op.add_column("chunks", sa.Column("copy_until", sa.Double))
    op.add_column("chunks", sa.Column("claimed_at", sa.Double))
    op.add_column("workers", sa.Column("memory_bytes", sa.BigInteger, nullable=False, server_default="0"))
    ordered = ["state", "job_id", "stage_index", "chunk_index"]
    op.create_index("ix_chunks_state_job_id_stage_index_chunk_index", "chunks", ordered)
    op.drop_index("ix_chunks_state_job_id", "chunks")


def downgrade() -> None:
    """Drop the columns; look for ready chunks by job."""
    op.create_index("ix_chunks_state_job_id", "chunks", ["state", "job_id"])
    op.drop_index("ix_chunks_state_job_id_stage_index_chunk_index", "chunks")
    op.drop_column("workers", "memory_bytes")
    for name in ("claimed_at", "copy_until", "copy_token", "copy_worker", "memory_bytes"):
        op.drop_column("chunks", name)
