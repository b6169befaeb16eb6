"""How alembic is to migrate: on the connection, and in the transaction, that ``Database.migrate`` opened."""

from alembic import context

from worker.store.database.tables import metadata

# Keys and indexes without a name get one by the convention of the metadata.
context.configure(connection=context.config.attributes["connection"], target_metadata=metadata, transactional_ddl=True)
context.run_migrations()
