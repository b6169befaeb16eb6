"""Digests of preflight records."""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"


def upgrade() -> None:
    """Add the column; records of earlier sessions have no digest and are read without one."""
    op.add_column("sessions", sa.Column("record_sha256", sa.String(64)))


def downgrade() -> None:
    """Forget the digests."""
    op.drop_column("sessions", "record_sha256")
