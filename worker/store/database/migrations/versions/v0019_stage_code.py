"""Code that chunks were planned for, and that workers run."""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"


def upgrade() -> None:
    """Add the columns; chunks of unfinished jobs have no code, so that their jobs are planned again."""
    op.add_column("chunks", sa.Column("code", sa.String(64)))
    op.add_column("workers", sa.Column("codes", sa.JSON, nullable=False, server_default="[]"))


def downgrade() -> None:
    """Forget the code."""
    op.drop_column("workers", "codes")
    op.drop_column("chunks", "code")
