"""Overlay videos and reports of reconstructions. Standard library only: web API, job store and stages read it."""

from dataclasses import dataclass

OVERLAY_KIND, REPORT_KIND = "overlay", "report"
VISUAL_KINDS = frozenset({OVERLAY_KIND, REPORT_KIND})
"""Kinds of the result files that are made to be looked at, and take minutes."""


@dataclass(frozen=True, slots=True)
class VisualChoices:
    """Overlay videos and the report are made of a reconstruction that is done, as far as its choices ask for them."""
