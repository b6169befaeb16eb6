"""Edits of the people of jobs, their revisions, and the people whom jobs have found."""

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"


def upgrade() -> None:
    """Add the columns; people of earlier jobs can be edited once these are reconstructed again."""
    op.add_column("jobs", sa.Column("edits", sa.JSON, nullable=False, server_default="[]"))
    op.add_column("jobs", sa.Column("revision", sa.Integer, nullable=False, server_default="0"))
    op.add_column("jobs", sa.Column("people", sa.JSON(none_as_null=True)))


def downgrade() -> None:
    """Forget the edits; results that they changed stay as they are."""
    op.drop_column("jobs", "people")
    op.drop_column("jobs", "revision")
    op.drop_column("jobs", "edits")
