"""Versions and digests of the stages' code, beside which ``CODE_VERSIONS`` is checked.

``python -m tests.worker.code_versions --record`` notes the digests of the sources in ``code_versions.json``. A stage
whose sources changed needs a higher number in ``worker/plan.py`` first; ``--results-unchanged`` says that the change
alters no result, so that what was computed earlier may be used.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TypedDict

from pipeline.code_digest import function_digest
from worker.plan import ASSOCIATE, CODE_VERSIONS, DETECT, EXPORT, FIT, LENGTHS, POSES

ROOT = Path(__file__).parents[2]
RECORDED = Path(__file__).with_suffix(".json")
RECORD = "python -m tests.worker.code_versions --record"

FUNCTIONS = {
    DETECT: "detect",
    LENGTHS: "measure_lengths",
    POSES: "find_poses",
    ASSOCIATE: "associate_people",
    FIT: "fit_skeletons",
    EXPORT: "export",
}


class Version(TypedDict):
    """A stage's number, and the digest of the sources that it stands for."""

    version: int
    digest: str


def versions_of(root: Path = ROOT, numbers: Mapping[str, int] = CODE_VERSIONS) -> dict[str, Version]:
    """Versions of all stages in a folder of sources."""
    return {
        stage: {"version": number, "digest": function_digest(root, "worker.stages", FUNCTIONS[stage])}
        for stage, number in numbers.items()
    }


def recorded() -> dict[str, Version]:
    """Versions of all stages as they were recorded."""
    return dict(json.loads(RECORDED.read_text(encoding="utf-8")))


def mistakes(before: Mapping[str, Version], now: Mapping[str, Version]) -> list[str]:
    """Stages whose sources changed and whose number did not, or went back; a sentence each."""
    found = []
    for stage, new in now.items():
        old = before.get(stage)
        if old is None or new == old:
            continue
        if new["version"] < old["version"]:
            found.append(f"The number of the stage {stage} went back from {old['version']} to {new['version']}.")
        elif new["version"] == old["version"]:
            found.append(
                f"The sources of the stage {stage} changed: raise its number in worker/plan.py and run `{RECORD}`; "
                f"if no result changes, only run `{RECORD} --results-unchanged`."
            )
    return found


def main() -> int:
    """Record the present digests."""
    parser = argparse.ArgumentParser(prog="python -m tests.worker.code_versions", description=__doc__)
    parser.add_argument("--record", action="store_true", required=True)
    parser.add_argument("--results-unchanged", action="store_true", help="Record new digests under the same numbers.")
    arguments = parser.parse_args()
    now = versions_of()
    if not arguments.results_unchanged and RECORDED.exists() and (found := mistakes(recorded(), now)):
        sys.stderr.write("\n".join(found) + "\n")
        return 1
    RECORDED.write_text(json.dumps(now, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
