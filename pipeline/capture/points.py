"""Sessions from arrays, and from 3D points of people, which another system has located: these have no cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from pipeline.calibration.vertical import AXES
from pipeline.capture.keypoint_arrays import floats, from_arrays
from pipeline.capture.keypoint_files.people import MAX_PEOPLE
from pipeline.capture.keypoint_files.points import REQUIRED
from pipeline.capture.keypoints import MAX_JOINTS, KeypointSession
from pipeline.capture.point_files.point_names import OWN_NAMES, find_joints, hip_centers_m, joint_set, pelvis_points
from pipeline.capture.point_files.point_reader import PointTable, flattened
from pipeline.capture.point_files.read_points import read_table
from pipeline.capture.point_files.static_trial import with_static_joints
from pipeline.core.data.arrays import read_only, short_text
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.errors import InputError, Problem
from pipeline.core.findings import Finding
from pipeline.core.joints import SIDES
from pipeline.core.options.arguments import checked
from pipeline.core.options.config import MAX_OUTPUT_FRAMES
from pipeline.core.options.job_choices import UNITS_M, Units, Up
from pipeline.core.parsing import FRAME_RATE_HZ, TRANSLATION, Quantity, UnreadableError, read_unique_json
from pipeline.core.parsing import FRAME_RATE_TOLERANCE as _TOLERANCE
from pipeline.core.paths import StrPath
from pipeline.core.problems import session_codes
from pipeline.core.problems.finding_codes import KEYPOINTS_FORM
from pipeline.core.problems.request_codes import INVALID_VALUE, SESSION_TOO_LARGE
from pipeline.motion.body_segments import RIGHT_FRONT_UP, SEGMENT_LABELS, SEGMENTS
from pipeline.video.frame_rate import without_rounding
from pipeline.video.timeline import cut_timebase, require_frames

_TRUNK_M = 0.5
_HIPS = "left_hip", "right_hip"
_ANKLES = "left_ankle", "right_ankle"
_LIMBS = tuple(f"{side}_{part}" for part in ("elbow", "wrist", "knee", "ankle") for side in SIDES)
# Share of a direction along an axis from which on standing people tell that it points up.
_UPRIGHT = 0.8
_TRUNKS_M = Quantity(0.25, 0.8, "metres")


@dataclass(frozen=True, slots=True, eq=False)
class PointSession(KeypointSession):
    """People located by another system, and their clock; there are no cameras.

    Parameters
    ----------
    cameras, times, timebase, detections, joints, folders, findings, layout, laboratory
        See ``KeypointSession``; there are output frames, joints and findings alone.
    people
        Tracks with positions in metres, Z up; NaN where a joint is unknown.

    Examples
    --------
    >>> import multicap
    >>> points_m = np.random.default_rng(0).normal(size=(20, 4, 3))
    >>> session = multicap.Session.from_points(points_m, ["LShoulder", "RShoulder", "LHip", "RHip"], 25.0, "m")
    >>> len(session.people), session.timebase.num_frames
    (1, 20)
    """

    people: tuple[Track3D, ...] = ()

    __repr__ = short_text

    @property
    def stretches(self) -> tuple[range, ...]:
        """All output frames."""
        return (range(self.timebase.num_frames),)

    def restricted(self, frames: range | None) -> "PointSession":
        """Restrict the session to a range of its output frames (``None``: all), which are numbered from 0."""
        if frames is None:
            return self
        require_frames(self.timebase, frames)
        people = []
        for track in self.people:
            first, stop = (max(0, frame - track.start_frame) for frame in (frames.start, frames.stop))
            part = replace(track.part(slice(first, stop)), start_frame=max(0, track.start_frame - frames.start))
            people += [part] * (part.num_frames > 0)
        return replace(self, timebase=cut_timebase(self.timebase, frames), people=tuple(people))

    def outline(self) -> "PointSession":
        """Session without the people."""
        return replace(self, people=())


@checked
def from_points(
    points: np.ndarray,
    names: Sequence[str] | np.ndarray,
    frame_rate_hz: float,
    units: Units | None = None,
    up: Up | None = None,
    joint_of: Mapping[str, str] | None = None,
) -> PointSession:
    """Make a session from 3D points that another system has located.

    Parameters
    ----------
    points
        Places (frames, points, 3), or (frames, people, points, 3); NaN where a point is unknown. Arrays of xarray are
        read by the names of their dimensions: (time, individuals, keypoints, space) in any order.
    names
        Names of the points: joints, markers of Plug-in Gait, segments of Theia, bones of characters.
    units, up
        Unit, and axis that points up; ``None``: people who stand tell it, and ``findings`` says it.
    joint_of
        Our joints by names of your own.

    Raises
    ------
    InputError
        With all problems of all arguments.
    """
    people, names = floats(points), tuple(map(str, np.asarray(names).tolist()))
    people = people[:, None] if people is not None and people.ndim == 3 else people
    if people is None or people.ndim != 4 or people.shape[2:] != (len(names), 3) or not people.size:
        message = f"points must be numbers of the shape (frames, people, {len(names)}, 3)."
        raise InputError([Problem(INVALID_VALUE, message, field="points")])
    numbers = [str(k + 1) for k in range(people.shape[1])]
    table = PointTable(**flattened(numbers, names, people), rate_hz=frame_rate_hz)
    return session_of_tables(
        [("points", "an array", table)], frame_rate_hz, units, up, _known_names(joint_of or {}), []
    )


@checked
def open_points(
    files: Sequence[StrPath],
    frame_rate_hz: float | None = None,
    units: Units | None = None,
    up: Up | None = None,
    joint_of: Mapping[str, str] | None = None,
    static: StrPath | None = None,
) -> PointSession:
    """Open files of 3D points: TRC, C3D, BVH, CSV, NetCDF, NPY, 3D JSON; files are of people at one time.

    Parameters
    ----------
    files
        Files, or folders of a JSON a frame.
    frame_rate_hz
        Rate, for files that do not state it.
    units, up, joint_of
        See ``from_points``.
    static
        File of a person who stands, with more markers of the same set, which tell joints that the files lack.

    Raises
    ------
    InputError
        With all problems of all files.
    """
    problems = [] if files else [Problem(INVALID_VALUE, "There are no files of 3D points.", field="files")]
    names, tables, still = _known_names(joint_of or {}), [], None
    try:
        still = None if static is None else read_table(Path(static))[0]
    except InputError as error:
        problems += error.problems
    for file in map(Path, files):
        try:
            table, form = read_table(file)
            if still is not None:
                table = with_static_joints(table, still, names, units)
            tables.append((file.name, form, table))
        except InputError as error:
            problems += error.problems
    return session_of_tables(tables, frame_rate_hz, units, up, names, problems)


class SessionMaker:
    """Makers of capture sessions from arrays; ``multicap.Session`` is its public name.

    Methods
    -------
    from_arrays
        2D joints of calibrated cameras.
    from_points, from_files
        3D points of people, in memory or in files of other systems.

    Examples
    --------
    >>> import multicap
    >>> import numpy as np
    >>> cameras = multicap.read_calibration(folder / "calibration.json")
    >>> keypoints_px = np.tile(np.linspace(100, 900, 34).reshape(17, 2), (3, 25, 1, 1))  # a person, 25 frames
    >>> session = multicap.Session.from_arrays(keypoints_px, None, cameras, 25.0, joints="coco-17")
    >>> session.timebase.num_frames, session.joints.names[0]
    (25, 'nose')
    """

    from_arrays = staticmethod(from_arrays)
    from_points = staticmethod(from_points)
    from_files = staticmethod(open_points)


def read_names(path: Path) -> dict[str, str]:
    """Table of a user's names: our joints by names of points, a JSON object; raises ``InputError``."""
    try:
        return parse_names(path.read_bytes()[: 2**20])
    except OSError:
        return parse_names(b"")


def parse_names(content: bytes) -> dict[str, str]:
    """Table of ``read_names`` from its content."""
    try:
        table = read_unique_json(content)
    except UnreadableError:
        table = None
    return _known_names(table)


def _known_names(table: Any) -> dict[str, str]:
    if not isinstance(table, Mapping) or any(str(joint) not in OWN_NAMES for joint in table.values()):
        message = "The table of names must be a JSON object of our joints, such as left_knee, by names of points."
        raise InputError([Problem(session_codes.KEYPOINTS_LAYOUT, message, field="names")])
    return dict(table)


def session_of_tables(
    tables: Sequence[tuple[str, str, PointTable]],
    frame_rate_hz: float | None,
    units: Units | None,
    up: Up | None,
    names: Mapping[str, str],
    problems: list[Problem],
) -> PointSession:
    """Put a session together from tables, each with the names of its file and of its format."""
    findings: list[Finding] = []
    rates = sorted(float(rate) for _, _, table in tables if (rate := frame_rate_hz or table.rate_hz) is not None)
    if tables and not rates:
        message, hint = "The points have no times.", "State frames a second (--frame-rate, or frame_rate_hz)."
        problems.append(Problem(session_codes.NO_FRAME_RATE, message, field="frame_rate_hz", hint=hint))
    elif rates and not (FRAME_RATE_HZ.holds(np.array(rates), _TOLERANCE) and rates[0] > rates[-1] * (1 - _TOLERANCE)):
        message = f"The frame rates of the files must be one, of {FRAME_RATE_HZ}."
        problems.append(Problem(session_codes.FRAME_RATE, message, field="frame_rate_hz"))
    people: list[tuple[float, Mapping[str, np.ndarray], np.ndarray | None]] = []
    for file, form, table in tables:
        read = _people(file, form, table, units, up, names, findings, problems)
        people += [(table.start_s, *person) for person in read]
    if len(people) > MAX_PEOPLE:
        problems.append(Problem(SESSION_TOO_LARGE, f"There are {len(people)} people; at most {MAX_PEOPLE} are read."))
    if problems:
        raise InputError(problems)
    rate_hz = float(without_rounding(rates[-1]))
    start_s = min(start for start, *_ in people)
    starts = [round((start - start_s) * rate_hz) for start, *_ in people]
    num_frames = max(start + len(next(iter(of.values()))) for start, (_, of, _) in zip(starts, people, strict=True))
    joints = joint_set(dict.fromkeys(name for _, of, _ in people for name in of))
    if num_frames > MAX_OUTPUT_FRAMES or num_frames * len(people) * len(joints.names) > MAX_JOINTS * 4 / 3:
        raise InputError([Problem(SESSION_TOO_LARGE, "The take is too long.", hint="Cut it into several captures.")])
    tracks = tuple(
        _track(k + 1, start, of, turns, joints.names)
        for k, (start, (_, of, turns)) in enumerate(zip(starts, people, strict=True))
    )
    timebase = Timebase(start_s, rate_hz, num_frames)
    return PointSession((), {}, timebase, {}, joints, {}, tuple(findings), people=tracks)


def _track(
    number: int, start: int, places: Mapping[str, np.ndarray], turns: np.ndarray | None, names: Sequence[str]
) -> Track3D:
    unknown = np.full((len(next(iter(places.values()))), 3), np.nan)
    xyz_m = np.stack([places.get(name, unknown) for name in names], axis=1)
    known = np.isfinite(xyz_m).all(-1)
    rows = np.flatnonzero(known.any(1))
    inside = slice(rows[0], rows[-1] + 1)
    xyz_m, known = np.where(known[..., None], xyz_m, np.nan)[inside], known[inside]
    source = np.where(known, Source.MEASURED, Source.ABSENT).astype(np.int8)
    error_px = np.full(known.shape, np.nan)
    score, views = read_only(known * 1.0), read_only(np.zeros(known.shape, int))
    stated = None if turns is None else read_only(turns[inside])
    figures = read_only(source), read_only(error_px), views, None, stated
    return Track3D(number, start + int(rows[0]), read_only(xyz_m), score, *figures)


def _people(
    file: str,
    form: str,
    table: PointTable,
    units: Units | None,
    up: Up | None,
    names: Mapping[str, str],
    findings: list[Finding],
    problems: list[Problem],
) -> list[tuple[dict[str, Float[np.ndarray, "frames 3"]], Float[np.ndarray, "frames segments 3 3"] | None]]:
    """Joints of the people of a table, in metres with Z up, and the orientations of segments that it states."""
    if not TRANSLATION.holds(table.xyz[np.isfinite(table.xyz)]):
        message = f"A place is not within {TRANSLATION} of the file's unit."
        problems.append(Problem(session_codes.KEYPOINTS_UNREADABLE, message, file=file))
        return []
    known, marks, missing = _located(file, table, names)
    if not known:
        hint = "Name the points by a table, JSON with our joint by your name: --names FILE, or names of the manifest."
        lacking = f"; missing are {', '.join(sorted(missing))}" if missing else " in one frame"
        message = f"No person has shoulders and hips{lacking}. The points are {', '.join(table.names[:8])}."
        problems.append(Problem(session_codes.KEYPOINTS_LAYOUT, message, file=file, hint=hint))
        return []
    length, ahead = _direction([_trunk(places) for places, _ in known])
    legs = [_middle(places, "hip") - _middle(places, "ankle") for places, _ in known if {*_ANKLES} <= places.keys()]
    _, below = _direction(legs)
    by_length = min(UNITS_M, key=lambda unit: abs(np.log(length * UNITS_M[unit] / _TRUNK_M)))
    unit = units or cast(Units, table.unit if table.unit in UNITS_M else by_length)
    if units is None and not _TRUNKS_M.holds(length * UNITS_M[unit]):
        message = f"The trunk is {length:.3g} long in the file's unit, which is none of {', '.join(UNITS_M)}."
        problems.append(
            Problem(session_codes.KEYPOINTS_LAYOUT, message, file=file, field="units", hint="State the unit.")
        )
    axis = cast(Up, max(AXES, key=lambda name: float(AXES[name] @ ahead)))
    stands = float(AXES[axis] @ ahead) > _UPRIGHT and not float(AXES[axis] @ below) < _UPRIGHT
    chosen = up or (axis if stands else table.up)
    told = [f"{file} is read as {form} in {unit} with {chosen.upper()} up", *marks]
    is_scaled = units is None and table.unit not in UNITS_M
    told += ["the unit is told by the trunk's length"] * is_scaled
    others = [name for name, unit_m in UNITS_M.items() if name != unit and _TRUNKS_M.holds(length * unit_m)]
    told += [f"it may be {' or '.join(others)}: state it"] * (is_scaled and bool(others))
    told += ["the axis is told by people who stand"] * (up is None and chosen != table.up)
    is_floating = up is None and not stands
    told += [f"no person stands, and {form} states no axis: state it if people lie or float"] * is_floating
    finding = Finding(KEYPOINTS_FORM, f"{'; '.join(told)}.", severity="info", evidence={"unit": unit, "up": chosen})
    is_partial = any(not {*_LIMBS} <= places.keys() for places, _ in known)
    is_guess = is_floating or is_partial or (is_scaled and others)
    findings.append(replace(finding, severity="warning") if is_guess else finding)
    world = UNITS_M[unit] * upright(chosen)
    turns = None
    if table.world_from_segment and len(known) == 1:
        turns = np.full((len(table.xyz), len(SEGMENTS), 3, 3), np.nan)
        for number, segment in enumerate(SEGMENTS):
            stated = table.world_from_segment.get(SEGMENT_LABELS[segment])
            if stated is not None:
                turns[:, number][..., RIGHT_FRONT_UP] = upright(chosen) @ stated
    people = []
    for places, pelvis_xyz in known:
        in_world = {joint: place @ world.T for joint, place in places.items()}
        if pelvis_xyz is not None:
            in_world |= dict(zip(_HIPS, hip_centers_m(pelvis_xyz @ world.T), strict=True))
        people.append((in_world, turns))
    return people


def _located(
    file: str, table: PointTable, names: Mapping[str, str]
) -> tuple[list[tuple[dict[str, np.ndarray], np.ndarray | None]], list[str], set[str]]:
    """Joints of each person in the file's unit, with the points of the pelvis where these tell the hips.

    Returns also what is guessed, and the joints that the most complete person lacks.
    """
    is_seen = np.isfinite(table.xyz).all(-1).any(0)
    groups: dict[str, list[int]] = {}
    for k in np.flatnonzero(is_seen).tolist():
        groups.setdefault(table.names[k].rpartition(":")[0], []).append(k)
    known, guesses, missing = [], [], set(REQUIRED)
    for person, points in groups.items():
        own_names = [table.names[k].rpartition(":")[2] for k in points]
        xyz, (joints, of_skin), pelvis = table.xyz[:, points], find_joints(own_names, names), pelvis_points(own_names)
        places = {joint: xyz[:, of].mean(1) for joint, of in joints.items()}
        needs_hips = pelvis is not None and not set(_HIPS) <= places.keys()
        if needs_hips:  # their centres follow when the unit is known
            places |= dict.fromkeys(_HIPS, xyz[:, pelvis].mean(1))
        missing = min(missing, {*REQUIRED} - places.keys(), key=len)
        if set(REQUIRED) <= places.keys() and np.isfinite(_trunk(places)).all(-1).any():
            known.append((places, xyz[:, pelvis] if needs_hips else None))
            used = {own_names[k] for of in joints.values() for k in of}
            twice = ", ".join(sorted(name for name in used if own_names.count(name) > 1))
            guesses += [f"{person or file}: several points have the name {twice}, the first is read"] * bool(twice)
            absent = ", ".join(name for name in _LIMBS if name not in places)
            guesses += [f"{person or file}: no point tells {absent}, which the skeleton guesses"] * bool(absent)
            guesses += [f"{person or file}: markers on the skin stand for {', '.join(of_skin)}"] * bool(of_skin)
    return known, guesses, missing


def upright(up: Up) -> Float[np.ndarray, "3 3"]:
    """Rotation of a world with another axis up to Z up; of Y up the inverse of our TRC and BVH."""
    axis = AXES[up]
    if abs(axis[2]) == 1:
        return np.diag([1.0, axis[2], axis[2]])
    across = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 1 else np.array([0.0, 1.0, 0.0])
    return np.stack([across, np.cross(axis, across), axis])


def _trunk(places: Mapping[str, np.ndarray]) -> Float[np.ndarray, "frames 3"]:
    """Vectors from the middle of the hips to the middle of the shoulders."""
    return _middle(places, "shoulder") - _middle(places, "hip")


def _middle(places: Mapping[str, np.ndarray], part: str) -> Float[np.ndarray, "frames 3"]:
    return (places[f"left_{part}"] + places[f"right_{part}"]) / 2


def _direction(vectors: Sequence[np.ndarray]) -> tuple[float, Float[np.ndarray, " 3"]]:
    """Median length and median direction of the known vectors, NaN without any."""
    known = np.concatenate([np.zeros((0, 3)), *vectors])
    known = known[np.isfinite(known).all(-1)]
    if not len(known):
        return np.nan, np.full(3, np.nan)
    lengths = np.maximum(np.linalg.norm(known, axis=-1, keepdims=True), 1e-9)
    return float(np.median(lengths)), np.median(known / lengths, axis=0)


def unseen(track: Track3D) -> Observations:
    """Observations of a person by no camera."""
    shape = track.num_frames, 0, track.xyz_m.shape[1]
    return Observations(track.track_id, np.zeros((*shape, 2)), np.zeros(shape))
