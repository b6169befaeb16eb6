"""Index that finds the ready chunks of a job."""

from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Look for chunks by state and job; by state alone it was a look at all ready chunks for every job in the queue."""
    op.create_index("ix_chunks_state_job_id", "chunks", ["state", "job_id"])
    op.drop_index("ix_chunks_state", "chunks")


def downgrade() -> None:
    """Look for them by state."""
    op.create_index("ix_chunks_state", "chunks", ["state"])
    op.drop_index("ix_chunks_state_job_id", "chunks")
