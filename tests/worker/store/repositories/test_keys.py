import time

import pytest
import sqlalchemy as sa

from tests.worker.store.conftest import StoreBench
from worker.store.database.tables import browser_sessions, keys
from worker.store.errors import NotFound
from worker.store.model.rights import Scope

READ = frozenset({Scope.READ})


def test_key_is_found_by_secret(jobs: StoreBench) -> None:
    key, secret = jobs.store.keys.add("studio", "portal", {Scope.WRITE, Scope.READ})
    assert secret.startswith("mc_")
    assert (key.tenant, key.name, key.scopes) == ("studio", "portal", frozenset({Scope.READ, Scope.WRITE}))
    assert (key.expires_at, key.revoked_at) == (None, None)
    assert jobs.store.keys.find(secret) == key
    for wrong in ("", "mc_", secret[:-1], secret + "x", secret.upper(), "\udce4"):
        assert jobs.store.keys.find(wrong) is None


def test_secrets_are_not_kept(jobs: StoreBench) -> None:
    key, secret = jobs.store.keys.add("studio", "portal", READ)
    cookie = jobs.store.browser_sessions.open(key, 60.0)
    engine = sa.create_engine(jobs.url)
    with engine.connect() as connection:
        rows = [*connection.execute(sa.select(keys)), *connection.execute(sa.select(browser_sessions))]
    engine.dispose()
    assert secret.removeprefix("mc_") not in str(rows)
    assert cookie not in str(rows)


def test_key_expired_is_invalid(jobs: StoreBench) -> None:
    _, secret = jobs.store.keys.add("studio", "guest", READ, lifetime_s=0.2)
    assert jobs.store.keys.find(secret) is not None
    time.sleep(0.3)
    assert jobs.store.keys.find(secret) is None


def test_key_revoked_ends_with_browser_sessions(jobs: StoreBench) -> None:
    key, secret = jobs.store.keys.add("studio", "portal", READ)
    other, other_secret = jobs.store.keys.add("studio", "script", READ)
    cookie = jobs.store.browser_sessions.open(key, 60.0)
    assert jobs.store.browser_sessions.find(cookie) == key
    revoked = jobs.store.keys.revoke(key.id)
    assert revoked.revoked_at is not None
    assert jobs.store.keys.revoke(key.id) == revoked
    assert jobs.store.keys.find(secret) is None
    assert jobs.store.browser_sessions.find(cookie) is None
    assert jobs.store.keys.find(other_secret) == other
    assert jobs.store.keys.all() == [revoked, other]
    with pytest.raises(NotFound):
        jobs.store.keys.revoke("nobody")


def test_there_are_keys_from_first_one_on(jobs: StoreBench) -> None:
    assert not jobs.store.keys.exist()
    key, _ = jobs.store.keys.add("studio", "portal", READ)
    assert jobs.store.keys.exist()
    jobs.store.keys.revoke(key.id)
    assert jobs.store.keys.exist()


def test_browser_session_ends_with_time_or_key(jobs: StoreBench) -> None:
    key, _ = jobs.store.keys.add("studio", "portal", READ, lifetime_s=3.0)
    short, long = jobs.store.browser_sessions.open(key, 0.2), jobs.store.browser_sessions.open(key, 60.0)
    closed = jobs.store.browser_sessions.open(key, 60.0)
    jobs.store.browser_sessions.close(closed)
    assert jobs.store.browser_sessions.find(closed) is None
    time.sleep(0.3)
    assert jobs.store.browser_sessions.find(short) is None
    assert jobs.store.browser_sessions.find(long) == key
    time.sleep(3.0)
    assert jobs.store.browser_sessions.find(long) is None
