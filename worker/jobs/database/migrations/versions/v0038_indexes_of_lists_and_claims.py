"""Indexes with which lists of sessions read no jobs, and claims not the whole queue."""

import sqlalchemy as sa
from alembic import op

revision = "0038"
down_revision = "0037"


def upgrade() -> None:
    """Look for a session's jobs by kind and for those that blur faces; have a tenant's queue in its whole order."""
    op.create_index("ix_jobs_session_id_kind_id", "jobs", ["session_id", "kind", "id"])
    if op.get_context().dialect.name == "postgresql":
        blurs = sa.text("CAST((spec ->> 'blur_faces') AS BOOLEAN) IS true")
        op.create_index("ix_jobs_session_id_blurs", "jobs", ["session_id"], postgresql_where=blurs)
    order = ["state", "tenant", "precedence", "queued_at"]
    op.create_index("ix_jobs_state_tenant_precedence_queued_at_id", "jobs", [*order, "id"])
    op.drop_index("ix_jobs_state_tenant_precedence_queued_at", "jobs")


def downgrade() -> None:
    """Look for a session's jobs by their ids alone, and have a tenant's queue in the order of its times."""
    order = ["state", "tenant", "precedence", "queued_at"]
    op.create_index("ix_jobs_state_tenant_precedence_queued_at", "jobs", order)
    op.drop_index("ix_jobs_state_tenant_precedence_queued_at_id", "jobs")
    if op.get_context().dialect.name == "postgresql":
        op.drop_index("ix_jobs_session_id_blurs", "jobs")
    op.drop_index("ix_jobs_session_id_kind_id", "jobs")
