"""Kinds of jobs: reconstructions, calibrations, and proxies of videos."""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"


def upgrade() -> None:
    """Add the column; earlier jobs that make something make calibrations."""
    kind = sa.Column("kind", sa.String(16), nullable=False, server_default="reconstruction")
    op.add_column("jobs", kind)
    op.execute("UPDATE jobs SET kind = 'calibration' WHERE making IS NOT NULL")


def downgrade() -> None:
    """Forget jobs of the new kind, and the column."""
    op.execute("DELETE FROM jobs WHERE kind = 'proxies'")
    op.drop_column("jobs", "kind")
