#!/usr/bin/env bash
# Entry of the stand-in images: what PostgreSQL's own image does with its variables at the first start; all else is run.
set -euo pipefail
if [ "${1:-}" = postgres ] && [ ! -s "$PGDATA/PG_VERSION" ]; then
    initdb --username "$POSTGRES_USER" --encoding UTF8 --locale C.UTF-8 --pwfile "$POSTGRES_PASSWORD_FILE" --auth-host scram-sha-256 --auth-local trust >/dev/null
    echo "host all all all scram-sha-256" >>"$PGDATA/pg_hba.conf"
    pg_ctl -w -o "-c listen_addresses=" start >/dev/null
    createdb --username "$POSTGRES_USER" "$POSTGRES_DB" || true
    pg_ctl -w stop >/dev/null
fi
if [ "${1:-}" = postgres ]; then set -- "$@" -c listen_addresses=*; fi
exec "$@"
