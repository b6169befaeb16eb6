"""Stages are named in ``pipeline/stages`` alone."""

import ast
import re
from pathlib import Path

from pipeline.stages.plan import EXPORT, FIT, STAGES

ROOT = Path(__file__).parents[1]
# These two words have other meanings too: a smoothing, and result files.
NAMES = {stage.name for stage in STAGES} - {FIT, EXPORT}


def test_no_stage_is_spelled_elsewhere() -> None:
    spelled = []
    for package in ("api", "multicap", "pipeline", "worker"):
        for path in (ROOT / package).rglob("*.py"):
            if path.parent != ROOT / "pipeline" / "stages":
                tree = ast.parse(path.read_bytes())
                constants = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and node.value in NAMES]
                spelled += [f"{path.relative_to(ROOT)}:{node.lineno}" for node in constants]
    assert not spelled


def test_no_stage_is_spelled_in_the_page() -> None:
    labels = {stage.label for stage in STAGES}
    for path in (ROOT / "api" / "portal").glob("*.js"):
        text = path.read_text(encoding="utf-8")
        assert not {label for label in labels if label in text}
        assert not set(re.findall(r"[\"'](\w+)[\"']|\b(\w+):", text)) & {(name, "") for name in NAMES}
        assert not {key for _, key in re.findall(r"[\"'](\w+)[\"']|\b(\w+):", text)} & NAMES
