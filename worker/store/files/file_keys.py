"""Keys of stored files.

::

    sessions/<session>/inputs/<number>-<name>
    sessions/<session>/record
    sessions/<session>/thumbnails/<camera number>-<picture number>.jpg
    sessions/<session>/stages/<output key>
    jobs/<job>/results/<name>/<name>                 of the reconstruction
    jobs/<job>/revisions/<revision>/<name>/<name>    after edits of its people
    jobs/<job>/visuals/<revision>/<name>/<name>      overlay videos, report and recording
    jobs/<job>/blurred/<name>/<name>                 copies of the videos with blurred heads
    jobs/<job>/interim/<attempt>/<output key>
    jobs/<job>/character/file                        copy of the character that the job moves
    characters/<character>/file

A result file has a folder of its own: it stays as long as a revision lists it, whatever becomes of the files beside it.
"""

import re

from pipeline.core.options.job_choices import BLURRED_KIND, VISUAL_KINDS

_KEY = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*(/[A-Za-z0-9_][A-Za-z0-9._-]*)*", re.ASCII)
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+", re.ASCII)
_MAX_NAME = 100


def session_prefix(session_id: str) -> str:
    """Prefix of the keys of a session's files, except for results."""
    return f"sessions/{session_id}/"


def job_prefix(job_id: str) -> str:
    """Prefix of the keys of a job's results and interim outputs."""
    return f"jobs/{job_id}/"


def character_prefix(character_id: str) -> str:
    """Prefix of the keys of a character's files."""
    return f"characters/{character_id}/"


def character_key(character_id: str) -> str:
    """Key of a character's file as it was sent."""
    return f"{character_prefix(character_id)}file"


def job_character_key(job_id: str) -> str:
    """Key of a job's copy of the character that it moves."""
    return f"{job_prefix(job_id)}character/file"


def input_key(session_id: str, number: int, name: str) -> str:
    """Key of an input file; it holds the client's name of the file as far as keys allow."""
    return f"{session_prefix(session_id)}inputs/{number}-{_UNSAFE.sub('_', name)[-_MAX_NAME:]}"


def record_key(session_id: str) -> str:
    """Key of the file that the preflight wrote for the workers."""
    return f"{session_prefix(session_id)}record"


def thumbnails_prefix(session_id: str) -> str:
    """Prefix of the keys of a session's thumbnails."""
    return f"{session_prefix(session_id)}thumbnails/"


def thumbnail_key(session_id: str, name: str) -> str:
    """Key of a small copy of a picture of a session's video."""
    return f"{thumbnails_prefix(session_id)}{name}"


def stage_key(session_id: str, output_key: str) -> str:
    """Key of a chunk's output."""
    return f"{session_prefix(session_id)}stages/{output_key}"


def interim_prefix(job_id: str, attempt: int) -> str:
    """Prefix of the keys of the interim outputs of an attempt of a job."""
    return f"{job_prefix(job_id)}interim/{attempt}/"


def interim_key(job_id: str, attempt: int, output_key: str) -> str:
    """Key of a chunk's interim output."""
    return f"{interim_prefix(job_id, attempt)}{output_key}"


def first_people_key(job_id: str, attempt: int, output_key: str) -> str:
    """Key of the people to be looked at while a job runs, beside an interim output."""
    return f"{interim_key(job_id, attempt, output_key)}.people"


def results_prefix(job_id: str, revision: int = 0) -> str:
    """Prefix of the keys of the result files of a revision of a job."""
    return f"{job_prefix(job_id)}results/" if revision == 0 else f"{job_prefix(job_id)}revisions/{revision}/"


def visuals_prefix(job_id: str, revision: int = 0) -> str:
    """Prefix of the keys of the visuals of a revision of a job; they may outlast its other files."""
    return f"{job_prefix(job_id)}visuals/{revision}/"


def result_key(job_id: str, name: str, revision: int = 0, kind: str = "") -> str:
    """Key of a result file of a kind."""
    if kind == BLURRED_KIND:
        prefix = f"{job_prefix(job_id)}blurred/"
    else:
        prefix = visuals_prefix(job_id, revision) if kind in VISUAL_KINDS else results_prefix(job_id, revision)
    return f"{prefix}{name}/{name}"


def is_key(key: str) -> bool:
    """Tell whether a text is a key."""
    return _KEY.fullmatch(key) is not None


def require_key(key: str) -> None:
    """Raise ``ValueError`` unless a text is a key."""
    if not is_key(key):
        raise ValueError(f"{key!r} is no key of an artifact")


def require_prefix(prefix: str) -> None:
    """Raise ``ValueError`` unless a text is a key with a slash behind it."""
    if not prefix.endswith("/"):
        raise ValueError(f"{prefix!r} does not end with a slash")
    require_key(prefix.removesuffix("/"))
