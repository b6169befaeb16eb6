"""Characters that jobs move."""

import sqlalchemy as sa
from alembic import op

revision = "0033"
down_revision = "0032"


def upgrade() -> None:
    """Add the column; earlier jobs have none."""
    op.add_column("jobs", sa.Column("character", sa.JSON(none_as_null=True)))


def downgrade() -> None:
    """Drop the column."""
    op.drop_column("jobs", "character")
