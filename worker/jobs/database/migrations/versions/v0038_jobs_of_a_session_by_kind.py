"""Indexes that count the reconstructions of a session, and find its few other jobs, without reading the jobs."""

import sqlalchemy as sa
from alembic import op

revision = "0038"
down_revision = "0037"


def upgrade() -> None:
    """Look for a session's jobs by kind, and for those that blur faces."""
    op.create_index("ix_jobs_session_id_kind_id", "jobs", ["session_id", "kind", "id"])
    op.drop_index("ix_jobs_session_id_id", "jobs")
    op.create_index(
        "ix_jobs_session_id_blurs",
        "jobs",
        ["session_id"],
        postgresql_where=sa.text("CAST((spec ->> 'blur_faces') AS BOOLEAN) IS true"),
        sqlite_where=sa.text("CAST(JSON_EXTRACT(spec, '$.\"blur_faces\"') AS BOOLEAN) IS 1"),
    )


def downgrade() -> None:
    """Look for a session's jobs by their ids alone."""
    op.drop_index("ix_jobs_session_id_blurs", "jobs")
    op.create_index("ix_jobs_session_id_id", "jobs", ["session_id", "id"])
    op.drop_index("ix_jobs_session_id_kind_id", "jobs")
