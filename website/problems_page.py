"""Page ``docs/reference/problems.md``: problem codes with what they mean and what to do."""

from collections.abc import Iterator, Mapping

from pipeline.core.problems import finding_codes as findings
from pipeline.core.problems import request_codes as requests
from pipeline.core.problems import session_codes as sessions
from pipeline.core.problems.code_group import Code, CodeGroup, read_sentences

GROUPS: tuple[CodeGroup, ...] = (
    *(requests.ANSWERS, requests.FIELDS, requests.PARTS, requests.SPECS),
    *(sessions.CALIBRATIONS, sessions.VIDEOS, sessions.KEYPOINTS, sessions.TIMES),
    *(requests.LIVE, requests.RECORDINGS, findings.STREAMS, findings.FILES, requests.EDITS, findings.PEOPLE),
    *(findings.JOBS, requests.READINESS, findings.WARNINGS, sessions.CHARACTERS, findings.COMMANDS, findings.FINDINGS),
)
"""All problem codes, in the order of the page."""

SENTENCES: Mapping[Code, tuple[str, str]] = (
    read_sentences(requests) | read_sentences(sessions) | read_sentences(findings)
)
"""Meaning and remedy of every code."""

_INTRODUCTION = """\
# Problem codes

This page lists every code of a problem or warning, what it means, and what to do.

Codes are stable; sentences may change. Answers of the API are `application/problem+json` (RFC 9457): `code` names the
problem, `errors` lists everything that is wrong with the request, `retryable` says whether the same request may succeed
later, and `request_id` is in the service's log. The column *where* says where a code appears: a number is the HTTP
status of the answer; `job` is the error of a job, `waiting` an outage that a job waits for, `attempt` a failed attempt
at one of its chunks, `readyz` an entry of `/readyz`, `command` the command line, `warning` a warning of a result,
`finding` a finding of a check (see [quality](../guide/quality.md) and [calibration](../guide/calibration.md)), `live`
a message of a [live capture](live-protocol.md), `recording` a message of a [recording](recording-protocol.md).
"""


def document() -> str:
    """Write the page as Markdown."""
    return "\n".join([_INTRODUCTION, *(line for group in GROUPS for line in _section(group))])


def _section(group: CodeGroup) -> Iterator[str]:
    yield from (f"## {group.title}", "", group.introduction, "")
    yield from ("| code | where | meaning | what to do |", "| --- | --- | --- | --- |")
    for code, places in group.places.items():
        meaning, remedy = SENTENCES[code]
        yield f"| [](){{ #{code} }}`{code}` | {', '.join(map(str, places))} | {meaning} | {remedy} |"
    yield ""
