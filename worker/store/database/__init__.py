"""The database: connection, transactions, tables, migrations."""
