"""Trace of the request for a job."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Add the column; jobs that are there belong to no trace."""
    op.add_column("jobs", sa.Column("trace", sa.String(55)))


def downgrade() -> None:
    """Forget the traces."""
    op.drop_column("jobs", "trace")
