"""Declarations of formats. Every process of Multicap loads this module, so it imports no science."""

from multicap import FileFormat

HIPS = FileFormat(
    "CSV, path of the hips", "text/csv; charset=utf-8", "joints", "multicap_example.hips:WRITER", ending="hips.csv"
)
