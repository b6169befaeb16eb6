"""Rows of characters: whose they are, what they count for, and their files."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.run.engine.stage import RETARGET
from tests.worker.store.backups import Data, opened_data, restored
from tests.worker.store.conftest import StoreBench
from worker.run.planning import plan_again, plan_job
from worker.store.database.quotas import Quotas
from worker.store.errors import Conflict, NotFound, QuotaExceeded
from worker.store.files.file_keys import character_key, character_prefix, job_character_key, job_prefix
from worker.store.model.character_records import Character, JobCharacter, StoredCharacterFile
from worker.store.model.rights import Actor
from worker.store.spec import JobSpec
from worker.store.tenant_records import Records

CONTENT = b"robot"
FACTS = {"format": "GLB", "num_bones": 2}
BONES = {"joints": [{"joint": "Hips", "bone": "pelvis"}]}


def add(records: Records, num_bytes: int = len(CONTENT)) -> Character:
    character_id = records.characters.reserve_id()
    digest = hashlib.sha256(CONTENT).hexdigest()
    file = StoredCharacterFile("robot.glb", character_key(character_id), num_bytes, digest)
    return records.characters.add(character_id, "Robot", file, FACTS, BONES, {"Hips": "pelvis"})


def test_character_of_other_tenant_is_unknown(jobs: StoreBench) -> None:
    mine, theirs = jobs.store.tenant("mine"), jobs.store.tenant("theirs")
    made = add(theirs)
    assert theirs.characters.get(made.id) == made == jobs.store.characters.get(made.id)
    assert [(listed.id, listed.facts) for listed in theirs.characters.page()] == [(made.id, FACTS)]
    assert mine.characters.page() == []
    for act in (
        lambda: mine.characters.get(made.id),
        lambda: mine.characters.rename(made.id, "Mine"),
        lambda: mine.characters.correct(made.id, FACTS, BONES, {}),
        lambda: mine.characters.delete(made.id),
    ):
        with pytest.raises(NotFound, match="no such character"):
            act()
    assert theirs.characters.get(made.id) == made


def test_pages_go_on_after_id(jobs: StoreBench) -> None:
    made = [add(jobs.store.tenant("mine")).id for _ in range(3)]
    mine = jobs.store.tenant("mine")
    assert [listed.id for listed in mine.characters.page(limit=2)] == [made[2], made[1]]
    assert [listed.id for listed in mine.characters.page(limit=2, after=made[1])] == [made[0]]


def test_changes_are_noted(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine", Quotas(), Actor("key", "request"))
    made = add(mine)
    for _ in range(2):  # the second time it is no change
        assert mine.characters.rename(made.id, "Robot B").name == "Robot B"
    changed = mine.characters.correct(made.id, FACTS | {"num_bones": 3}, {"joints": []}, {})
    assert (changed.facts["num_bones"], changed.bones, changed.corrections) == (3, {"joints": []}, {})
    mine.characters.delete(made.id)
    assert [event.act for event in reversed(jobs.store.audit.events("mine"))] == [
        "character-created",
        "character-renamed",
        "character-corrected",
        "character-deleted",
    ]


def test_bytes_count_for_quota(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine", Quotas(stored_bytes=1000), Actor())
    made = add(mine, 700)
    used = mine.usage().stored_bytes
    assert 700 < used < 800
    with pytest.raises(QuotaExceeded):
        add(mine, 300)
    with pytest.raises(QuotaExceeded):
        mine.characters.correct(made.id, FACTS, {"joints": ["x" * 300]}, {})
    mine.characters.correct(made.id, FACTS, {}, {})
    assert mine.usage().stored_bytes < used
    mine.characters.delete(made.id)
    assert mine.usage().stored_bytes == 0


def test_files_are_removed_with_their_row_or_without_one(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    made = add(mine)
    assert jobs.store.removals.due() == []
    mine.characters.delete(made.id)
    assert [removal.prefix for removal in jobs.store.removals.due()] == [character_prefix(made.id)]
    late = StoredCharacterFile("robot.glb", "characters/x/file", 5, "")
    with pytest.raises(Conflict, match="send it again"):
        mine.characters.add("x", "Robot", late, FACTS, BONES, {})


def moved_by(data: Data, content: bytes) -> tuple[str, JobCharacter]:
    """Id of a new job with the character that it moves, of which a copy is stored."""
    job_id = data.store.jobs.reserve_id()
    key, digest = job_character_key(job_id), hashlib.sha256(content).hexdigest()
    data.artifacts.put_bytes(key, content)
    return job_id, JobCharacter("x", StoredCharacterFile("robot.glb", key, len(content), digest), {"Hips": "pelvis"})


def test_job_keeps_copy_of_character(tmp_path: Path) -> None:
    with opened_data(tmp_path / "data") as data:
        session_id, moved = data.add_session(), moved_by(data, CONTENT)
        session = data.store.sessions.get(session_id)
        stages = plan_job(session, JobSpec(), character=moved[1])
        job = data.store.jobs.add(session_id, JobSpec(), stages, moved=moved)
        assert (job.id, job.character) == moved
        assert [stage.name for stage in job.stages].count(RETARGET) == 1
        again = plan_again(session, job)
        keys = [[chunk.output_key for chunk in stage.chunks] for stage in stages]
        assert [[chunk.output_key for chunk in stage.chunks] for stage in again] == keys
        other = replace(moved[1], corrections={})
        differs = [
            stage.name
            for stage, changed in zip(stages, plan_job(session, JobSpec(), character=other), strict=True)
            if [chunk.output_key for chunk in stage.chunks] != [chunk.output_key for chunk in changed.chunks]
        ]
        assert RETARGET in differs
        assert not {"detect", "identify", "fit"} & set(differs)
        claim = data.store.leases.claim("worker", 30.0)
        assert claim is not None
        assert claim.config.character == moved[1].digest
        assert data.back_up(tmp_path / "whole.tar").problems == ()
        data.artifacts.delete_prefix(job_prefix(job.id))
        (problem,) = data.back_up(tmp_path / "lost.tar").problems
        assert (problem.path, problem.needed) == (f"artifacts/{moved[1].file.key}", True)
        with pytest.raises(Conflict, match="send the request again"):
            data.store.jobs.add(session_id, JobSpec(), stages, moved=moved)


def test_backups_have_files(tmp_path: Path) -> None:
    with opened_data(tmp_path / "data") as data:
        made = add(data.store)
        data.artifacts.put_bytes(made.file.key, CONTENT)
        assert data.back_up(tmp_path / "whole.tar").problems == ()
        data.artifacts.delete_prefix(character_prefix(made.id))
        (problem,) = data.back_up(tmp_path / "lost.tar").problems
        assert (problem.path, problem.needed) == (f"artifacts/{made.file.key}", True)
    restored(tmp_path / "whole.tar", tmp_path / "there")
    with opened_data(tmp_path / "there") as there:
        assert there.store.characters.get(made.id) == made
        with there.artifacts.open(made.file.key, made.file.sha256) as file:
            assert file.read() == CONTENT
