"""Length of the chunks of a session's jobs, which follows the measured speed."""

import sqlalchemy as sa
from alembic import op

revision = "0039"
down_revision = "0038"


def upgrade() -> None:
    """Add the length; that of sessions so far is the default."""
    op.add_column("sessions", sa.Column("chunk_frames", sa.Integer, nullable=False, server_default="100"))


def downgrade() -> None:
    """Drop the length."""
    op.drop_column("sessions", "chunk_frames")
