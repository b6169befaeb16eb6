"""Indexes with which lists of sessions read no jobs."""

import sqlalchemy as sa
from alembic import op

revision = "0038"
down_revision = "0037"


def upgrade() -> None:
    """Look for a session's jobs by kind, and on PostgreSQL for those that blur faces."""
    op.create_index("ix_jobs_session_id_kind_id", "jobs", ["session_id", "kind", "id"])
    if op.get_context().dialect.name == "postgresql":
        blurs = sa.text("CAST((spec ->> 'blur_faces') AS BOOLEAN) IS true")
        op.create_index("ix_jobs_session_id_blurs", "jobs", ["session_id"], postgresql_where=blurs)


def downgrade() -> None:
    """Look for a session's jobs by their ids alone."""
    if op.get_context().dialect.name == "postgresql":
        op.drop_index("ix_jobs_session_id_blurs", "jobs")
    op.drop_index("ix_jobs_session_id_kind_id", "jobs")
