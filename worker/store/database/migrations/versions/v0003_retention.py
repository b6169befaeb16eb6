"""Time that the results of a job are kept."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Add the columns; jobs that are there keep their results."""
    op.add_column("jobs", sa.Column("retention_s", sa.Double))
    op.add_column("jobs", sa.Column("expires_at", sa.Double))
    op.create_index("ix_jobs_expires_at", "jobs", ["expires_at"])


def downgrade() -> None:
    """Forget when results were to go."""
    op.drop_index("ix_jobs_expires_at", "jobs")
    op.drop_column("jobs", "expires_at")
    op.drop_column("jobs", "retention_s")
