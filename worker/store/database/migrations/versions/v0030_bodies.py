"""Bodies that workers have installed."""

import sqlalchemy as sa
from alembic import op

revision = "0030"
down_revision = "0029"


def upgrade() -> None:
    """Add the column; workers of earlier versions have none."""
    op.add_column("workers", sa.Column("bodies", sa.JSON, nullable=False, server_default="[]"))


def downgrade() -> None:
    """Drop the column."""
    op.drop_column("workers", "bodies")
