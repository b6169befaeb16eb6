"""Formats of people's files that workers can write."""

import sqlalchemy as sa
from alembic import op

revision = "0031"
down_revision = "0030"


def upgrade() -> None:
    """Add the column, which workers fill."""
    op.add_column("workers", sa.Column("formats", sa.JSON, nullable=False, server_default="[]"))


def downgrade() -> None:
    """Drop the column."""
    op.drop_column("workers", "formats")
