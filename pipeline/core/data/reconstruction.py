"""The result of a reconstruction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.data.cameras import Camera, Refinement, Synchronization, Timebase
from pipeline.core.data.detections import DamagedVideo
from pipeline.core.data.laboratory import Laboratory
from pipeline.core.data.own_points import OwnTracks
from pipeline.core.data.people import Doubt, Observations, PersonLoss, Track3D
from pipeline.core.findings import Finding, SessionCheck
from pipeline.core.joints import JointOffsets, JointSet
from pipeline.core.options.arguments import checked
from pipeline.core.options.edits import Accept
from pipeline.core.options.providers import ProviderName
from pipeline.core.paths import StrPath

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes

Content = Literal["joints", "angles", "contacts"]
Form = Literal["long", "wide"]

# References: records import no other room.
_TO_XARRAY = "pipeline.export.notebook.named_arrays:to_xarray"
_TO_DATAFRAME = "pipeline.export.notebook.named_arrays:to_dataframe"
_TO_PARQUET = "pipeline.export.notebook.named_arrays:to_parquet"
_PLOT = "pipeline.export.notebook.plots:plot"
_HTML = "pipeline.export.notebook.plots:html"


class Subject(NamedTuple):
    """People's bodies, as the masses of segments are taken from a table."""

    table: str = "de-leva"  # Table of segments: ``de-leva`` or ``dumas``
    sex: str = "unstated"  # ``female``, ``male``, or ``unstated``: the mean of both
    mass_kg: float | None = None  # Mass of each person; ``None``: unknown


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """Result of a reconstruction.

    Parameters
    ----------
    cameras, joints, timebase
        Cameras of the session, refined if they were, joints of the tracks, and times of the output frames.
    located, observations
        Tracks with joints as association located them, before smoothing and fit; observations behind them.
    animation, warnings
        Final tracks and skeletons, in the same order; findings about the files and the choices.
    num_approximate_frames, damaged
        Number of output frames that exceeded a limit of exact association; videos with damaged frames by camera.
    doubts, losses
        Doubts about each person's identity, in the tracks' order; frames in which people are lost, or were phantoms.
    offsets
        Offsets of the detector's marks from the joints' centres, with which the skeletons were fitted.
    refinement, synchronization, check
        Refinement of the calibration and measured clocks, ``None`` without; check of the session by its people.
    provider
        Execution provider of the networks; ``None`` if there was nothing to detect.
    layout, subject
        Layout of keypoints without names, and how it was told, or ``None``; table of segments, sex and mass of people
        who have none in ``subjects``, by number.
    is_emptied, own
        True if edits removed all people who were found; points of the user's own.
    laboratory
        Recording of a laboratory beside the cameras, with the time of its file if it is known; ``None``: nothing.
    accepted
        Places of people, by the number of the track, that were looked at and are right; frames are of the take.
        Cameras that are right have the number 0.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> take = multicap.reconstruct(session)
    >>> take.timebase.frame_rate_hz, len(take.tracks) == len(take.motions)
    (25.0, True)
    """

    cameras: tuple[Camera, ...]
    joints: JointSet
    timebase: Timebase
    located: Sequence[Track3D]
    observations: Sequence[Observations]
    animation: Animation
    warnings: tuple[Finding, ...] = ()
    num_approximate_frames: int = 0
    damaged: tuple[DamagedVideo, ...] = ()
    doubts: Sequence[Sequence[Doubt]] = ()
    losses: Sequence[PersonLoss] = ()
    offsets: JointOffsets = field(default_factory=dict)
    refinement: Refinement | None = None
    synchronization: Synchronization | None = None
    check: SessionCheck = field(default_factory=SessionCheck)
    provider: ProviderName | None = None
    layout: Mapping[str, Any] | None = None
    is_emptied: bool = False
    subject: Subject = field(default_factory=Subject)
    own: OwnTracks = field(default_factory=OwnTracks)
    laboratory: Laboratory | None = None
    accepted: Mapping[int, Sequence[Accept]] = field(default_factory=dict)
    subjects: Mapping[int, Subject] = field(default_factory=dict)

    def subject_of(self, person: int) -> Subject:
        """Sex and mass of a person, by number, and the table of segments."""
        return self.subjects.get(person, self.subject)

    @property
    def tracks(self) -> tuple[Track3D, ...]:
        """Tracks with final positions."""
        return self.animation.tracks

    @property
    def motions(self) -> tuple[SkeletonMotion, ...]:
        """Skeleton motions, in the tracks' order."""
        return self.animation.motions

    def accepts(self, kind: str, person: int = 0, frames: range | None = None, camera: str | None = None) -> bool:
        """True if a person or a camera was looked at, and is right; ``None``: in any frames."""
        return any(
            (edit.kind, edit.camera) == (kind, camera)
            and (frames is None or (edit.start_frame < frames.stop and frames.start < edit.stop_frame))
            for edit in self.accepted.get(person, ())
        )

    def to_xarray(self) -> "xr.Dataset":
        """Return everything as named arrays, which the package ``movement`` takes.

        This, tables and plots need Multicap's extra ``notebook``; without it they raise ``PipelineError``.

        Returns
        -------
        xarray.Dataset
            ``position`` in metres with dimensions (time, space, keypoints, individuals), ``confidence`` in [0, 1],
            ``uncertainty_m``, ``error_px``, ``views``, ``source``; ``angle_deg`` and ``angle_sigma_deg`` (time, angles,
            individuals); ``contact``, the confidence of a foot's contact, and ``pinned`` (time, feet, individuals).
            NaN where a value is unknown.
        """
        return cast("xr.Dataset", resolve_name(_TO_XARRAY)(self))

    @checked
    def to_dataframe(self, of: Content = "joints", form: Form = "long") -> "pd.DataFrame":
        """Return joints, angles or contacts of the feet as a table of pandas.

        Parameters
        ----------
        of
            Content. Joints have metres, confidence, uncertainty and reprojection error; angles degrees.
        form
            ``long``: a row for each known joint, angle or contact of a person in a frame. ``wide``: a row a frame, and
            columns such as ``Person 1.nose.x_m``; NaN where a value is unknown.

        Raises
        ------
        InputError
            If ``of`` or ``form`` is no such name.
        """
        return cast("pd.DataFrame", resolve_name(_TO_DATAFRAME)(self, of, form))

    @checked
    def to_parquet(self, path: StrPath, of: Content = "joints", form: Form = "long") -> Path:
        """Write a table of ``to_dataframe`` as a Parquet file; return its path."""
        return cast(Path, resolve_name(_TO_PARQUET)(self, path, of, form))

    @checked
    def plot(
        self,
        person: int | None = None,
        *,
        angle: str | None = None,
        camera: str | None = None,
        frame: int | None = None,
        ax: "Axes | None" = None,
    ) -> "Axes":
        """Draw people in 3D, an angle over time, or a camera's view, with Matplotlib.

        Parameters
        ----------
        person
            Number of the person; ``None``: all people.
        angle
            Name of a joint angle in degrees, such as ``left_knee_flexion``, which is drawn over time.
        camera
            Name of a camera: its picture's frame with the detected joints and the projected skeletons.
        frame
            Output frame of a skeleton or a view; ``None``: the middle frame of the person.
        ax
            Axes to draw on, with a 3D projection for people; ``None``: axes of a new figure.

        Raises
        ------
        InputError
            If there is no such person, angle, camera or frame.
        """
        return cast("Axes", resolve_name(_PLOT)(self, person, angle, camera, frame, ax))

    def __repr__(self) -> str:
        timebase = self.timebase
        return (
            f"<Reconstruction: {len(self.tracks)} people, {timebase.num_frames} frames at {timebase.frame_rate_hz:g} "
            f"Hz, {len(self.joints.names)} joints, {len(self.cameras)} cameras>"
        )

    def _repr_html_(self) -> str:
        return str(resolve_name(_HTML)(self))
