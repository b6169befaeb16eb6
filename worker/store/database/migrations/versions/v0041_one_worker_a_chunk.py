"""A chunk is run by one worker at a time."""

import sqlalchemy as sa
from alembic import op

revision = "0041"
down_revision = "0040"


def upgrade() -> None:
    """Drop the columns of second workers."""
    for name in ("copy_worker", "copy_token", "copy_until"):
        op.drop_column("chunks", name)


def downgrade() -> None:
    """Add them."""
    op.add_column("chunks", sa.Column("copy_worker", sa.String))
    op.add_column("chunks", sa.Column("copy_token", sa.String(36)))
    op.add_column("chunks", sa.Column("copy_until", sa.Double))
