"""Module run by ``python -m``: writes the costs in ``docs/measurements.md`` from ``docs/cost.json``."""

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from api.cli.benchmark.cost.tables import CostTable, cost_tables
from api.web.contract.documentation import write_or_check

PAGE = Path(__file__).parents[4] / "docs" / "measurements.md"
MEASURED = PAGE.with_name("cost.json")

BEGIN = "<!-- Made from cost.json by `python -m api.cli.benchmark.cost.cost_section`. -->"
END = "<!-- End of what is made from cost.json. -->"

# Largest load of a machine that does nothing else.
_IDLE = 0.5
_CONDITION = {
    False: "",
    True: " (beside other work, so that seconds that pass are more than on a machine of one's own)",
}


def section(cost: Mapping[str, Any]) -> str:
    """Write the section as Markdown from a document of `multicap benchmark all --json`."""
    machine = cost["machine"]
    lines = [
        BEGIN,
        f"Measured on {cost['measured_at'][:10]} by `multicap benchmark all --json`: {machine['processor']}, "
        f"{machine['cores']} cores, {machine['memory_gib']:.0f} GiB, ONNX Runtime {machine['onnxruntime']}, "
        f"Python {machine['python']}; load of the minute before: {machine['load']:.1f}"
        f"{_CONDITION[machine['load'] > _IDLE]}.",
        *(line for table in cost_tables(cost) for line in _lines(table)),
        "",
        END,
    ]
    return "\n".join(lines)


def _lines(table: CostTable) -> Iterator[str]:
    yield from ("", f"**{table.title}.** {table.about}", "")
    yield from (_row(table.columns), _row(["---"] * len(table.columns)), *map(_row, table.rows))


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def document() -> str:
    """Page with the section made anew; all else in it stays."""
    before, begin, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"docs/{PAGE.name} lacks the lines {BEGIN} and {END}")
    return before + section(json.loads(MEASURED.read_text(encoding="utf-8"))) + after


def main(words: Sequence[str] | None = None) -> int:
    """Write or compare the page, and return the exit code."""
    return write_or_check(PAGE, document(), "api.cli.benchmark.cost.cost_section", words)


if __name__ == "__main__":
    sys.exit(main())
