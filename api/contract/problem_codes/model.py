"""Records that describe problem codes and groups of them."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ProblemCode:
    """Stable code of a problem, with its meaning and remedy.

    Parameters
    ----------
    name
        The code, such as ``video_truncated``.
    where
        Places in which clients meet the code: HTTP statuses of answers as digits, the usual one first; ``job`` (the
        error of a job), ``waiting`` (what a job waits for), ``attempt`` (a failed attempt at a chunk), ``readyz`` (the
        errors of ``/readyz``), ``command`` (the command line), ``warning`` (a warning of a job and in
        ``metrics.json``), ``finding`` (of a check).
    meaning, remedy
        One sentence each.
    """

    name: str
    where: tuple[str, ...]
    meaning: str
    remedy: str

    @property
    def statuses(self) -> tuple[int, ...]:
        """HTTP statuses of answers with the code, the usual one first."""
        return tuple(int(place) for place in self.where if place.isdecimal())


@dataclass(frozen=True, slots=True)
class CodeGroup:
    """Problem codes about one subject: a section of ``docs/problems.md``."""

    title: str
    introduction: str
    codes: tuple[ProblemCode, ...]
