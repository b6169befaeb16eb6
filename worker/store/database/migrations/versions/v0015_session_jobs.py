"""Index of the jobs of a session in order."""

from alembic import op

revision = "0015"
down_revision = "0014"


def upgrade() -> None:
    """Look for jobs by session and id; by session alone SQLite rather looked through all jobs of the tenant."""
    op.create_index("ix_jobs_session_id_id", "jobs", ["session_id", "id"])
    op.drop_index("ix_jobs_session_id", "jobs")


def downgrade() -> None:
    """Look for them by session."""
    op.create_index("ix_jobs_session_id", "jobs", ["session_id"])
    op.drop_index("ix_jobs_session_id_id", "jobs")
