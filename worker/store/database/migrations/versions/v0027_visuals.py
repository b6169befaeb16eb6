"""Jobs that make overlay videos and reports of edited jobs anew."""

import sqlalchemy as sa
from alembic import op

revision = "0027"
down_revision = "0026"


def upgrade() -> None:
    """Add the columns."""
    op.add_column("jobs", sa.Column("of_job", sa.String(36)))
    op.add_column("jobs", sa.Column("visuals_old_at", sa.Double))
    for column in ("of_job", "visuals_old_at"):
        op.create_index(f"ix_jobs_{column}", "jobs", [column])


def downgrade() -> None:
    """Forget jobs of the new kind, and the columns."""
    op.execute("DELETE FROM jobs WHERE kind = 'visuals'")
    for column in ("of_job", "visuals_old_at"):
        op.drop_index(f"ix_jobs_{column}", "jobs")
        op.drop_column("jobs", column)
