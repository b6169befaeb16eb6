"""Metadata of clients with a session."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    """Add the column; so far nobody noted anything."""
    op.add_column("sessions", sa.Column("client_metadata", sa.JSON, nullable=False, server_default="{}"))


def downgrade() -> None:
    """Forget it."""
    op.drop_column("sessions", "client_metadata")
