"""Children of Celery's pool: what they do not keep of their parent."""

import os
import select
import socket
import stat

import pytest

from worker.run.app import release_inherited_sockets


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
