"""Log files: lines are JSON, files are rotated while a program writes, and a full disk stops no program."""

import json
import os
import shutil
from pathlib import Path

from tests.small_disk import small_disk
from tests.waiting import wait_for
from worker.run.process.log_files import NUM_OLD_FILES, LogFile


def write(log: LogFile, content: bytes) -> None:
    """Write through a pipe, as the output of a program."""
    reading, writing = os.pipe()
    log.follow(os.fdopen(reading, "rb"))
    with os.fdopen(writing, "wb") as pipe:
        pipe.write(content)
    log.close()


def test_a_line_that_is_no_json_becomes_the_event_of_one(tmp_path: Path) -> None:
    path = tmp_path / "logs" / "worker.log"
    write(LogFile(path), b'{"event": "chunk_done"}\n\nworker: Warm shutdown\n\xff{\n')
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == '{"event": "chunk_done"}'
    assert [json.loads(line)["event"] for line in lines] == ["chunk_done", "worker: Warm shutdown", "\\xff{"]
    assert all(json.loads(line)["timestamp"].endswith("Z") for line in lines[1:])


def test_parts_are_rotated_while_the_program_writes(tmp_path: Path) -> None:
    path = tmp_path / "api.log"
    lines = [json.dumps({"event": "request", "number": number, "path": "x" * 900}) for number in range(100)]
    write(LogFile(path, max_bytes=10_000), "\n".join(lines).encode())
    parts = sorted(tmp_path.iterdir(), key=lambda part: -int(part.suffix.removeprefix(".").replace("log", "0")))
    assert [part.name for part in parts] == [f"api.log.{n}" for n in range(NUM_OLD_FILES, 0, -1)] + ["api.log"]
    assert all(part.stat().st_size <= 10_000 for part in parts)
    kept = "".join(part.read_text() for part in parts).splitlines()
    assert kept == lines[-len(kept) :]
    assert len(kept) > 40


def test_lines_are_lost_while_the_disk_is_full_and_written_again_afterwards(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 1) as disk:
        filler = disk / "filler"
        filler.write_bytes(bytes(2**20 - 64 * 2**10))
        log = LogFile(disk / "api.log")
        write(log, b'{"event": "lost"}\n' * 10_000)
        filler.unlink()
        write(log, b'{"event": "kept"}\n')
        events = [json.loads(line)["event"] for line in (disk / "api.log").read_text().splitlines()]
        assert (events[0], events[-1]) == ("lost", "kept")
        assert len(events) < 10_000


def test_a_log_that_somebody_removed_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "logs" / "api.log"
    log = LogFile(path)
    reading, writing = os.pipe()
    log.follow(os.fdopen(reading, "rb"))
    with os.fdopen(writing, "wb", buffering=0) as pipe:
        pipe.write(b'{"event": "before"}\n')
        wait_for(path.exists)
        shutil.rmtree(path.parent)
        pipe.write(b'{"event": "after"}\n')
    log.close()
    assert path.read_text() == '{"event": "after"}\n'
