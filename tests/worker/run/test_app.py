"""Celery's application: messages in work, and what children of its pool do not keep of their parent."""

import os
import select
import socket
import stat

import pytest
from kombu.message import Message

from worker.run.app import WakingRequest, create_celery, release_inherited_sockets
from worker.run.settings import WorkerSettings
from worker.store.queue import TASK_NAME


@pytest.mark.skipif(not hasattr(select, "epoll"), reason="needs Linux: epoll")
def test_closed_connection_of_parent_is_reported_once() -> None:
    ours, brokers = socket.socketpair()
    told, tell = os.pipe()
    wait, end = os.pipe()
    with select.epoll() as poll:
        poll.register(ours, select.EPOLLIN)
        child = os.fork()
        if child == 0:
            os.close(end)
            release_inherited_sockets()
            # The number stays taken: an object of the parent that closes it later closes nothing else.
            os.write(tell, b"released" if stat.S_ISCHR(os.fstat(ours.fileno()).st_mode) else b"occupied")
            os.read(wait, 1)
            os._exit(0)
        try:
            assert os.read(told, 8) == b"released"
            ours.close()
            brokers.close()
            assert poll.poll(0.1) == []
        finally:
            os.close(end)
            os.waitpid(child, 0)
            for pipe in (told, tell, wait):
                os.close(pipe)


def test_files_and_pipes_of_parent_stay() -> None:
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        release_inherited_sockets()
        os.write(write, b"here")
        os._exit(0)
    os.waitpid(child, 0)
    assert os.read(read, 4) == b"here"
    os.close(read)
    os.close(write)


def test_lost_acknowledgement_lets_worker_receive_more(monkeypatch: pytest.MonkeyPatch) -> None:
    celery = create_celery(WorkerSettings(broker_url="memory://"))
    received: list[Message] = []
    with celery.connection_for_write() as connection, connection.channel() as channel:
        consumer = celery.amqp.TaskConsumer(channel, on_message=received.append, accept=["json"])
        consumer.qos(prefetch_count=1)
        with consumer:
            celery.send_task(TASK_NAME, connection=connection)
            celery.send_task(TASK_NAME, connection=connection)
            connection.drain_events(timeout=5)
            assert not channel.qos.can_consume()

            def refuse(*_: object, **__: object) -> None:
                raise ConnectionRefusedError

            monkeypatch.setattr(channel, "basic_ack", refuse)
            task, (message,) = celery.tasks[TASK_NAME], received
            WakingRequest(
                message, app=celery, task=task, on_ack=message.ack_log_error, connection_errors=(OSError,)
            ).acknowledge()
            connection.drain_events(timeout=5)
    assert task.Request == "worker.run.app:WakingRequest"
    assert len(received) == 2
