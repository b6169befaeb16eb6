"""Execution providers of workers, and of the networks of jobs."""

import sqlalchemy as sa
from alembic import op

revision = "0035"
down_revision = "0034"


def upgrade() -> None:
    """Add the columns; networks of earlier jobs ran on the CPU."""
    op.add_column("workers", sa.Column("provider", sa.JSON, nullable=False, server_default="{}"))
    op.add_column("jobs", sa.Column("provider", sa.String, nullable=False, server_default=""))


def downgrade() -> None:
    """Drop the columns."""
    op.drop_column("workers", "provider")
    op.drop_column("jobs", "provider")
