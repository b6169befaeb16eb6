"""Outage that a job waits for, and the folder that holds the bytes of an upload."""

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"


def upgrade() -> None:
    """Add the columns; the folder of earlier uploads is unknown."""
    op.add_column("jobs", sa.Column("waiting_for", sa.JSON(none_as_null=True)))
    op.add_column("uploads", sa.Column("spool", sa.String))


def downgrade() -> None:
    """Drop the columns."""
    op.drop_column("uploads", "spool")
    op.drop_column("jobs", "waiting_for")
