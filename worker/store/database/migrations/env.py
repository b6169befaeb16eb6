"""How alembic is to migrate: on the connection, and in the transaction, that ``Database.migrate`` opened."""

from alembic import context

context.configure(connection=context.config.attributes["connection"], transactional_ddl=True)
context.run_migrations()
