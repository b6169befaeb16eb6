"""Index of tenants with waiting or running jobs, and of their oldest jobs."""

from alembic import op

revision = "0018"
down_revision = "0017"


def upgrade() -> None:
    """Add the index, by which workers choose the next tenant whose chunk they claim."""
    op.create_index("ix_jobs_state_tenant_queued_at", "jobs", ["state", "tenant", "queued_at"])


def downgrade() -> None:
    """Remove the index."""
    op.drop_index("ix_jobs_state_tenant_queued_at", "jobs")
