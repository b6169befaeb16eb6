"""Revisions of result files, and precedence of edits of people."""

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"

_EARLIER, _INDEX = "ix_jobs_state_tenant_queued_at", "ix_jobs_state_tenant_precedence_queued_at"


def upgrade() -> None:
    """Add the columns; the files of earlier jobs are of their present revision."""
    op.add_column("results", sa.Column("revision", sa.Integer, nullable=False, server_default="0"))
    op.execute("UPDATE results SET revision = (SELECT jobs.revision FROM jobs WHERE jobs.id = results.job_id)")
    op.add_column("jobs", sa.Column("results_revision", sa.Integer))
    op.execute("UPDATE jobs SET results_revision = revision WHERE state = 'succeeded'")
    op.add_column("jobs", sa.Column("precedence", sa.Integer, nullable=False, server_default="1"))
    op.drop_index(_EARLIER, "jobs")
    op.create_index(_INDEX, "jobs", ["state", "tenant", "precedence", "queued_at"])


def downgrade() -> None:
    """Forget the revisions; every file counts as one of the present revision."""
    op.drop_index(_INDEX, "jobs")
    op.create_index(_EARLIER, "jobs", ["state", "tenant", "queued_at"])
    op.drop_column("jobs", "precedence")
    op.drop_column("jobs", "results_revision")
    op.drop_column("results", "revision")
