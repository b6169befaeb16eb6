"""The page of a report: HTML with its style, script and data inside, which asks for nothing from outside."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from pipeline.core.findings import Finding, worst_first
from pipeline.export.report import biomechanics
from pipeline.export.report.force_plots import force_parts
from pipeline.export.report.markup import Markup, data, element, join, source_hash
from pipeline.export.report.pictures import Picture

_ASSETS = Path(__file__).parent / "assets"
# The page's viewer, which api/portal/vendor.mjs puts there when npm's packages are installed.
_VIEWER = _ASSETS / "viewer.js"

Rows = Sequence[tuple[str, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class ReportContents:
    """Contents of a report."""

    name: str  # Name of the take
    motion: Mapping[str, Any]  # Motion and quality for the script, as ``embed_motion`` gives them
    metrics: Mapping[str, Any]  # Content of ``metrics.json``
    angles: Sequence[biomechanics.PersonAngles]  # Joint angles of the first people
    findings: Sequence[Finding]  # Warnings of the result
    pictures: Sequence[Picture]  # Pictures of the cameras, pictures of a moment together
    notes: Sequence[str]  # Sentences about the report itself, such as pictures that are missing
    settings: Rows  # Choice and value of each choice of the reconstruction, and whether it is the usual one
    # Name and version of each program and network; name and SHA-256 of each file
    versions: Rows
    inputs: Rows
    cameras: Rows  # Name, size, and reprojection error of each camera


def encode_page(contents: ReportContents) -> bytes:
    """Write the report as one file of HTML."""
    style = "".join(_text(path) for path in (_ASSETS / "report.css", _ASSETS / "viewer.css"))
    script = _text(_VIEWER)
    policy = (
        f"default-src 'none'; img-src data:; style-src {source_hash(style)}; script-src {source_hash(script)}; "
        "base-uri 'none'; form-action 'none'"
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="generator", content="Multicap"),
        element("title", f"{contents.name}, report"),
        element("style", Markup(style)),
    )
    body = element(
        "body",
        _header(contents),
        element(
            "main",
            _findings(contents.findings),
            _take(contents),
            _angles(contents),
            _gait(contents),
            _forces(contents),
            _pictures(contents),
            _section(
                "details",
                "Details",
                _table("Cameras", ("Camera", "Size", "Median reprojection error"), contents.cameras),
                _table("Settings", ("Option", "Value", "Default"), contents.settings),
                _table("Versions", ("Program or network", "Version"), contents.versions),
                _table("Input files", ("File", "SHA-256"), contents.inputs),
            ),
        ),
        data("take", contents.motion),
        element("script", Markup(script), type="module"),
    )
    return join(Markup("<!DOCTYPE html>\n"), element("html", head, body, lang="en"), Markup("\n")).encode()


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _header(contents: ReportContents) -> Markup:
    metrics = contents.metrics
    num_people, duration_s = len(metrics["people"]), metrics["num_frames"] / metrics["frame_rate_hz"]
    error_px = metrics["reprojection_error_px"]["median"]
    facts = [
        "no people found" if num_people == 0 else _count(num_people, "person", "people"),
        _count(len(contents.cameras), "camera"),
        f"{duration_s:.1f} s, {metrics['num_frames']:,} frames at {metrics['frame_rate_hz']:g} Hz",
    ]
    if error_px is not None:
        facts.append(f"median reprojection error {error_px:.1f} px")
    return element(
        "header",
        element("h1", contents.name),
        element("p", (element("span", fact) for fact in facts), class_="facts"),
    )


def _findings(findings: Sequence[Finding]) -> Markup:
    if not findings:
        return Markup()
    items = (
        element(
            "li",
            element(
                "b", "Error: " if finding.severity == "error" else "Warning: " if finding.severity == "warning" else ""
            ),
            f"{finding.camera}: {finding.message}" if finding.camera else finding.message,
            " " + finding.hint if finding.hint else "",
            class_=finding.severity,
        )
        for finding in worst_first(findings)
    )
    return _section("warnings", "Warnings", element("ul", items, class_="findings"))


def _take(contents: ReportContents) -> Markup:
    """The viewer, which the script fills, and the figures of the people."""
    notes = []
    if not _VIEWER.is_file():
        notes.append("The 3D view is missing: the libraries of the page were not installed where this report was made.")
    if contents.motion["stride"] > 1:
        notes.append(
            f"The take is long: the 3D view has every {_ordinal(contents.motion['stride'])} frame and "
            "interpolates the others. The result files have all frames."
        )
    notes.append(
        "Drag to turn, scroll or pinch to come closer, drag with the right button to move. Click bands to go there."
    )
    without = element("noscript", element("p", "The 3D view needs JavaScript; everything else works without it."))
    motion = _section(
        "motion", "Motion", element("div", id="viewer"), without, (element("p", note, class_="quiet") for note in notes)
    )
    if not contents.metrics["people"]:
        return motion
    rows = map(_person_row, contents.metrics["people"], contents.motion["people"])
    return join(motion, _section("quality", "Quality of each person", _table("People", _PEOPLE, rows)))


_PEOPLE = ("Person", "Frames", "Measured", "Reprojection error", "Cameras a joint", "Height", "Doubts about identity")


def _person_row(figures: Mapping[str, Any], person: Mapping[str, Any]) -> tuple[str, ...]:
    start, num_frames = figures["start_frame"], figures["num_frames"]
    return (
        person["name"],
        f"{start} - {start + num_frames - 1}",
        f"{100 * figures['coverage']:.0f} %",
        _figure(figures["reprojection_error_px"], "px", 1),
        _figure(figures["views_per_joint"], "", 1),
        _figure(figures["stature_m"], "m", 2),
        str(len(figures["identity"]["doubts"])),
    )


def _gait(contents: ReportContents) -> Markup:
    """Tables of gait and movements; empty if no person walks, jumps, squats or sits down."""
    names = [person["name"] for person in contents.motion["people"]]
    named = list(zip(names, contents.metrics["people"], strict=True))
    tables = [
        _table(caption, columns, rows)
        for caption, columns, rows in (
            ("Gait", biomechanics.GAIT_COLUMNS, biomechanics.gait_rows(named)),
            ("Movements", biomechanics.MOVEMENT_COLUMNS, biomechanics.movement_rows(named)),
            ("Centre of mass", biomechanics.BALANCE_COLUMNS, biomechanics.balance_rows(named)),
            ("Forces", biomechanics.FORCE_COLUMNS, biomechanics.force_rows(named, contents.metrics.get("forces", ()))),
        )
        if rows
    ]
    if not tables:
        return Markup()
    note = "Means and standard deviations over strides that neither turn nor start nor stop."
    return _section("gait", "Gait and movement", element("p", note, class_="quiet"), tables)


def _angles(contents: ReportContents) -> Markup:
    if not contents.angles:
        return Markup()
    notes = [
        "By the definitions of the International Society of Biomechanics; "
        "`multicap help biomechanics` says what not to trust."
    ]
    if len(contents.metrics["people"]) > len(contents.angles):
        notes.append(f"These are the first {len(contents.angles)} people; metrics.json has the ranges of all.")
    parts = biomechanics.angle_parts(contents.angles, contents.metrics["frame_rate_hz"])
    return _section("angles", "Joint angles", (element("p", note, class_="quiet") for note in notes), parts)


def _forces(contents: ReportContents) -> Markup:
    parts = list(force_parts(contents.angles, contents.metrics["frame_rate_hz"]))
    return _section("forces", "Forces", parts) if parts else Markup()


def _pictures(contents: ReportContents) -> Markup:
    if not contents.pictures and not contents.notes:
        return Markup()
    parts = []
    for moment, of_moment in groupby(contents.pictures, key=lambda picture: picture.moment):
        figures = (
            element(
                "figure",
                element(
                    "img",
                    src=f"data:image/jpeg;base64,{base64.b64encode(picture.jpeg).decode('ascii')}",
                    width=picture.size_px[0],
                    height=picture.size_px[1],
                    alt=f"Camera {picture.camera} with the skeletons over its picture",
                ),
                element("figcaption", f"{picture.camera}, {picture.time_s:.3f} s"),
            )
            for picture in of_moment
        )
        go = element("button", f"Show frame {moment.frame}", type="button", class_="go", data_frame=moment.frame)
        parts.append(join(element("h3", moment.title, " ", go), element("div", figures, class_="pictures")))
    return _section(
        "cameras-pictures", "Cameras", parts, (element("p", note, class_="quiet") for note in contents.notes)
    )


def _section(identifier: str, title: str, *content: str | Iterable[str]) -> Markup:
    heading = element("h2", title, id=f"{identifier}-title")
    return element("section", heading, *content, id=identifier, aria_labelledby=f"{identifier}-title")


def _table(caption: str, columns: Sequence[str], rows: Iterable[tuple[str, ...]]) -> Markup:
    body = (
        element("tr", element("th", row[0], scope="row"), (element("td", cell) for cell in row[1:])) for row in rows
    )
    head = element("thead", element("tr", (element("th", column, scope="col") for column in columns)))
    table = element("table", element("caption", caption), head, element("tbody", body))
    return element("div", table, class_="scroll", tabindex=0, role="group", aria_label=caption)


def _figure(value: float | None, unit: str, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}".rstrip()


def _count(number: int, singular: str, plural: str | None = None) -> str:
    return f"{number} {singular if number == 1 else plural or singular + 's'}"


def _ordinal(number: int) -> str:
    ending = "th" if number % 100 in {11, 12, 13} else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
