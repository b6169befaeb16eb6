"""Sessions whose videos were deleted."""

import sqlalchemy as sa
from alembic import op

revision = "0034"
down_revision = "0033"


def upgrade() -> None:
    """Add the column; the videos of earlier sessions are there."""
    op.add_column("sessions", sa.Column("videos_deleted_at", sa.Double()))


def downgrade() -> None:
    """Drop the column."""
    op.drop_column("sessions", "videos_deleted_at")
