"""Names of people beside their result files."""

import sqlalchemy as sa
from alembic import op

revision = "0029"
down_revision = "0028"


def upgrade() -> None:
    """Add the column; files of earlier versions are named by the number of the person."""
    op.add_column("results", sa.Column("person_name", sa.String))


def downgrade() -> None:
    """Drop the column."""
    op.drop_column("results", "person_name")
