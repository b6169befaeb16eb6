"""Names of sessions as searches compare them."""

import unicodedata

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"


def upgrade() -> None:
    """Add the column, and fill it: databases fold the case of letters differently, so it is done here."""
    op.add_column("sessions", sa.Column("search_name", sa.String, nullable=False, server_default=""))
    fill = sa.text("UPDATE sessions SET search_name = :name WHERE id = :id")
    for row in op.get_bind().execute(sa.text("SELECT id, name FROM sessions")).all():
        name = unicodedata.normalize("NFKC", row.name).casefold()
        op.get_bind().execute(fill, {"name": name, "id": row.id})


def downgrade() -> None:
    """Forget the names for searches."""
    op.drop_column("sessions", "search_name")
