"""``python -m api.web.contract.problem_codes.page``: write ``docs/problems.md``, or check it against the code."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from api.web.contract.documentation import write_or_check
from pipeline.core.problems.characters import CHARACTERS
from pipeline.core.problems.commands import COMMANDS
from pipeline.core.problems.fields import FIELDS
from pipeline.core.problems.findings import FILES, FINDINGS, PEOPLE
from pipeline.core.problems.jobs import EDITS, JOBS, READINESS
from pipeline.core.problems.live import LIVE, STREAMS
from pipeline.core.problems.model import CodeGroup
from pipeline.core.problems.recordings import RECORDINGS
from pipeline.core.problems.requests import ANSWERS, PARTS
from pipeline.core.problems.sessions import CALIBRATIONS, KEYPOINTS, TIMES, VIDEOS
from pipeline.core.problems.specs import SPECS
from pipeline.core.problems.warnings import WARNINGS

PAGE = Path(__file__).parents[4] / "docs" / "problems.md"

GROUPS: tuple[CodeGroup, ...] = (
    *(ANSWERS, FIELDS, PARTS, SPECS, CALIBRATIONS, VIDEOS, KEYPOINTS, TIMES),
    *(LIVE, RECORDINGS, STREAMS, FILES, EDITS, PEOPLE, JOBS, READINESS, WARNINGS, CHARACTERS, COMMANDS, FINDINGS),
)
"""All problem codes, in the order of the page."""

_INTRODUCTION = """\
# Problem codes

This page lists every code of a problem or warning, what it means, and what to do.

Codes are stable; sentences may change. Answers of the API are `application/problem+json` (RFC 9457): `code` names the
problem, `errors` lists everything that is wrong with the request, `retryable` says whether the same request may succeed
later, and `request_id` is in the service's log. The column *where* says where a code appears: a number is the HTTP
status of the answer; `job` is the error of a job, `waiting` an outage that a job waits for, `attempt` a failed attempt
at one of its chunks, `readyz` an entry of `/readyz`, `command` the command line, `warning` a warning of a result,
`finding` a finding of a check (see [preflight](preflight.md) and [calibration](calibration.md)), `live` a message of a
[live capture](live_service.md), `recording` a message of a [recording](phones_service.md).

This page is made from the code: `python -m api.web.contract.problem_codes.page` writes it.
"""


def document() -> str:
    """Write the page as Markdown."""
    return "\n".join([_INTRODUCTION, *(line for group in GROUPS for line in _section(group))])


def _section(group: CodeGroup) -> Iterator[str]:
    yield from (f"## {group.title}", "", group.introduction, "")
    yield from ("| code | where | meaning | what to do |", "| --- | --- | --- | --- |")
    for code in group.codes:
        yield f"| `{code.name}` | {', '.join(code.where)} | {code.meaning} | {code.remedy} |"
    yield ""


def main(words: Sequence[str] | None = None) -> int:
    """Write or compare the page, and return the exit code."""
    return write_or_check(PAGE, document(), "api.web.contract.problem_codes.page", words)


if __name__ == "__main__":
    sys.exit(main())
