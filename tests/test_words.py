"""Words of code and documents: each of these hides a noun, and an engineer of another language stumbles over it."""

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("api", "clients", "deploy", "docker", "docs", "multicap", "pipeline", "worker")
SUFFIXES = {".css", ".html", ".js", ".md", ".py", ".toml", ".ts", ".yml"}
MAX_OCCURRENCES = 60

# Words, and what to write in their place
AVOIDED = {
    r"those of": "the noun again",
    r"that of": "the noun again",
    r"whom": "another order: 'people seen by two cameras'",
    r"as of": "'like', 'as in', 'as for'",
    r"anew": "'again', or a verb: 'rebuilt', 'requested again'",
    r"is the whole way": "'Entry point: ...'",
    r"at stake": "'affected'",
    r"(?<=\"\"\")(?:Who|Whom|Whose|What|Which|Where|Whether)": "the noun first",
    r"(?:[Nn]o|[Ss]ome)body": "'no person', 'a person', 'the user'",
}


def occurrences(text: str) -> Counter[str]:
    """Number of each avoided word in a text; lines of code count as well as prose."""
    return Counter({word: len(re.findall(rf"\b{word}\b", text)) for word in AVOIDED})


def files() -> list[Path]:
    """Sources and documents that we write; pages of decisions and of measurements are a record."""
    kept = [path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.suffix in SUFFIXES]
    made = {"node_modules", "vendor", "dist", "contract.ts", "__pycache__"}
    ours = [path for path in kept if not {"lab", *made} & {*path.parts}]
    return [*ours, *ROOT.glob("*.md")]


def test_words_sought_and_not_written_are_counted() -> None:
    found = occurrences('"""What people whom it sees do anew."""\nthose of, that of.')
    assert found == occurrences("") | {r"those of": 1, r"that of": 1, r"whom": 1, r"anew": 1, list(AVOIDED)[-2]: 1}


def test_words_in_code_and_documents_are_few() -> None:
    by_file = {path.relative_to(ROOT).as_posix(): occurrences(path.read_text("utf-8")) for path in files()}
    total = sum((+counts for counts in by_file.values()), Counter())
    told = [f"{name}: {dict(+counts)}" for name, counts in by_file.items() if +counts]
    assert total.total() <= MAX_OCCURRENCES, "\n".join([f"{total} {AVOIDED}", *told])
