"""Choices of a reconstruction, each declared once: name, values, default, limits and one sentence.

The job's spec, the options of the command line, ``GET /v1/options``, the form of the page and
``docs/reference/options.md`` are made from these declarations, in the words of ``pipeline.core.options.choices``. For
type checkers the union of a choice's values is a ``Literal`` of all names. Beside the standard library it knows where
files are installed: the web API imports this module.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Literal, cast, get_args

from pipeline.core.findings import Finding
from pipeline.core.options.choices import (
    About,
    Network,
    OtherNames,
    Value,
    declared_choices,
    named_values,
    plainly_annotated,
)
from pipeline.core.options.edits import PeopleEdit, of_motion
from pipeline.core.options.file_formats import Export as Export  # noqa: PLC0414 - it is one of the choices
from pipeline.core.options.job_choices import CalibrationChoices, ProxyChoices, VisualChoices
from pipeline.core.problems.finding_codes import BODIES_CLUSTERED, OVERLAY_WITHOUT_VIDEOS

MAX_OUTPUT_FRAMES = 1_000_000
"""Frames of a session, and of the motion in result files: duration x frame rate. More than two hours at 120 Hz."""


Method = (
    Annotated[Literal["tracking"], Value("Tracking whole bodies")]
    | Annotated[Literal["clustering"], Value("Clustering joints, for crowds")]
)
Profile = (
    Annotated[Literal["fast"], Value("Fast", note="Mean joint error 28 mm (rendered people).")]
    | Annotated[Literal["balanced"], Value("Balanced", note="Mean joint error 25 mm (rendered people).")]
    | Annotated[Literal["accurate"], Value("Accurate", note="Mean joint error 24 mm (rendered people).")]
)
DetectedJoints = (
    Annotated[Literal["auto"], Value("Default of the profile")]
    | Annotated[Literal["body"], Value("Body, 17 joints")]
    | Annotated[Literal["feet"], Value("Body, heels and toes", note="Doubles the time of Fast, free with the others.")]
    | Annotated[Literal["whole"], Value("Body, feet and fingers", note="Takes 1.6 times as long with Balanced.")]
)
Detector = (
    Annotated[Literal["auto"], Value("Networks of the profile")]
    | Annotated[Literal["movenet-multipose"], Network("MoveNet MultiPose")]
    | Annotated[Literal["movenet-multipose-int8"], Network("MoveNet MultiPose, 8 bits")]
    | Annotated[Literal["openpose-mobilenet-thin"], Network("OpenPose MobileNet, for clustering", leaves_fields=True)]
    | Annotated[
        Literal["human-pose-estimation-0001"],
        Network(
            "human-pose-estimation-0001, for clustering",
            leaves_fields=True,
            publisher="Intel's Open Model Zoo (FP16-INT8)",
        ),
    ]
    # Networks of the user's own; see `pipeline.detection.own`.
    | Annotated[str, OtherNames("^own-[a-z0-9]+(-[a-z0-9]+)*-[0-9a-f]{12}$")]
)
Smoothing = (
    Annotated[Literal["none"], Value("None")]
    | Annotated[Literal["butterworth"], Value("Butterworth low-pass")]
    | Annotated[Literal["one-euro"], Value("One-euro low-pass")]
    | Annotated[Literal["fit"], Value("Skeleton fit")]
)
Feet = (
    Annotated[Literal["off"], Value("Never")]
    | Annotated[Literal["auto"], Value("When contact is likely")]
    | Annotated[Literal["always"], Value("When contact is possible")]
)
Appearance = Annotated[Literal["on"], Value("Used")] | Annotated[Literal["off"], Value("Not used")]
JointCenters = (
    Annotated[Literal["auto"], Value("By the network")]
    | Annotated[Literal["off"], Value("No offsets")]
    | Annotated[Literal["movenet-multipose"], Value("MoveNet MultiPose")]
    | Annotated[Literal["openpose-mobilenet-thin"], Value("OpenPose MobileNet thin")]
)
RefineCalibration = (
    Annotated[Literal["off"], Value("Off")]
    | Annotated[Literal["auto"], Value("Where it helps", note="Only where people show that cameras are off.")]
)
Sync = (
    Annotated[Literal["declared"], Value("Times of the files")]
    | Annotated[Literal["auto"], Value("Measured from motion")]
)
Preset = (
    Annotated[Literal["default"], Value("Standard names")]
    | Annotated[Literal["blender"], Value("Blender")]
    | Annotated[Literal["unity-humanoid"], Value("Unity, humanoid")]
    | Annotated[Literal["unreal"], Value("Unreal Engine, mannequin")]
    | Annotated[Literal["mixamo"], Value("Mixamo")]
    | Annotated[Literal["humanik"], Value("HumanIK (MotionBuilder, Maya)")]
)
Timeline = (
    Annotated[Literal["take"], Value("Keep everyone in sync: every file covers the whole take")]
    | Annotated[Literal["person"], Value("Trim each file to the frames in which the person is visible")]
)

Body = (
    Annotated[Literal["human"], Value("Human", note="Shaped by the person's bones.")]
    | Annotated[Literal["capsules"], Value("Capsules", note="One around each bone.")]
)

SegmentTable = Annotated[Literal["de-leva"], Value("de Leva 1996")] | Annotated[Literal["dumas"], Value("Dumas 2007")]
Sex = (
    Annotated[Literal["unstated"], Value("Mean of both")]
    | Annotated[Literal["female"], Value("Female")]
    | Annotated[Literal["male"], Value("Male")]
)


@dataclass(frozen=True, slots=True)
class MotionChoices:
    """Choices that a job and a configuration of the pipeline have alike."""

    method: Annotated[Method, About("Method", "How detections are matched to people.")] = "tracking"
    profile: Annotated[Profile, About("Profile", "Speed and accuracy of the detection.", group="quality")] = field(
        default="balanced", kw_only=True
    )
    joints: Annotated[DetectedJoints, About("Joints", "Joints to find in videos.")] = field(
        default="auto", kw_only=True
    )
    detector: Annotated[Detector, About("Detector", "One network in place of the profile's.")] = "auto"
    follow_s: Annotated[
        float,
        About(
            "Time between detections, s",
            "Longest time between detections. Slow motion between them is interpolated; 0 detects every frame.",
            minimum=0.0,
            maximum=0.2,
            option="follow",
        ),
    ] = field(default=0.04, kw_only=True)
    smoothing: Annotated[Smoothing, About("Smoothing", "How joint positions are smoothed.")] = "fit"
    cutoff_hz: Annotated[
        float,
        About(
            "Butterworth cutoff, Hz",
            "Cutoff of the Butterworth low-pass in Hz. It must be below half the frame rate.",
            above=0.0,
            maximum=1000.0,
            option="cutoff",
        ),
    ] = 6.0
    feet: Annotated[Feet, About("Feet on the floor", "When standing feet are held still.")] = "auto"
    appearance: Annotated[
        Appearance,
        About("Clothing colours", "Use the colours of clothes to tell people apart. Only for the method `tracking`."),
    ] = "on"
    joint_centers: Annotated[
        JointCenters, About("Joint centres", "Offsets from the detector's marks to the centres of the joints.")
    ] = "auto"
    refine_calibration: Annotated[
        RefineCalibration, About("Calibration refinement", "Move the cameras to fit the people of the take.")
    ] = "off"
    sync: Annotated[Sync, About("Synchronisation", "How the clocks of the cameras are aligned.")] = "declared"

    @property
    def networks(self) -> "Networks":
        """Networks for ``profile``, ``joints`` and ``detector``."""
        if self.detector != "auto":
            return Networks(self.detector)
        profile = _PROFILES[self.profile]
        has_feet = self.detected_joints != "body"
        return Networks(
            profile.body,
            near=profile.near if profile.refines_body or has_feet else None,
            hand=_HAND if self.detected_joints == "whole" else None,
            refines_body=profile.refines_body,
            again=profile.near,
            is_sized=True,
        )

    @property
    def detected_joints(self) -> "JointsOfBody":
        """Joints that the networks of the profile detect; a single ``detector`` has joints of its own."""
        return _PROFILES[self.profile].joints if self.joints == "auto" else self.joints


@dataclass(frozen=True, slots=True)
class JobChoices(MotionChoices):
    """Choices of a job; ``worker.store.spec.JobSpec`` has these fields."""

    frame_range: Annotated[
        tuple[int, int] | None,
        About(
            "Frames",
            "First output frame, and the frame after the last one.",
            minimum=0,
            unset="all frames",
            option="frames",
        ),
    ] = None
    output_rate_hz: Annotated[
        float | None,
        About(
            "Frame rate of files, Hz",
            "Frame rate of the motion in all files, in Hz. Metrics keep the capture's rate.",
            minimum=1.0,
            maximum=240.0,
            unset="the capture's rate",
            option="output-rate",
        ),
    ] = None
    people: Annotated[
        Annotated[Literal["auto"], Value("Everyone")] | int,
        About(
            "Largest number of people",
            "Keep at most this many people (the best seen).",
            minimum=1,
            maximum=1000,
            group="people",
        ),
    ] = "auto"
    exports: Annotated[
        tuple[Export, ...],
        About(
            "Files of each person",
            "Formats of each person's files. `skeletons.json` and `metrics.json` are always written.",
            group="purpose",
        ),
    ] = ("bvh",)
    preset: Annotated[
        Preset, About("Target application", "Names, axes, unit and rest pose of BVH and FBX files.", group="purpose")
    ] = "default"
    timeline: Annotated[
        Timeline, About("Frames of the files", "Frames that each person's files cover.", group="purpose")
    ] = "take"
    body: Annotated[
        Body,
        About(
            "Body shape",
            "Body in GLB, FBX and USD files. Humans need `multicap bodies install` on the service.",
            group="purpose",
        ),
    ] = "capsules"
    segments: Annotated[
        SegmentTable, About("Masses of segments", "Table from which the centre of mass is computed.", group="purpose")
    ] = "de-leva"
    sex: Annotated[Sex, About("Sex", "Sex of the people, for masses of segments.", group="purpose")] = "unstated"
    mass_kg: Annotated[
        float | None,
        About(
            "Mass, kg",
            "Mass of each person in kg, for momenta.",
            minimum=1.0,
            maximum=500.0,
            unset="momenta per kilogram",
            group="purpose",
        ),
    ] = None
    report: Annotated[
        bool, About("Report", "One file, `report.html`, with the motion in 3D, pictures and quality figures.")
    ] = False
    overlay: Annotated[
        bool, About("Overlay videos", "A copy of each camera's video with the skeletons drawn over it.")
    ] = False
    blur_faces: Annotated[bool, About("Blurred faces", "Blur all heads in videos, reports and links.")] = False
    force: Annotated[
        bool, About("Ignore errors", "Reconstruct although the check found errors. The result may be wrong.")
    ] = False


DEFAULT_CHUNK_FRAMES = 100


@dataclass(frozen=True, slots=True)
class ReconstructionConfig(JobChoices):
    """Configuration of one reconstruction; the result does not depend on the last two fields.

    Parameters
    ----------
    tracking
        Parameters of the tracker by name, in place of the parameters that are derived from the session; see
        ``tracking.parameters.TrackingParameters``.
    clustering
        Likewise, parameters of clustering; see ``clustering.parameters.ClusteringParameters``.
    making
        Choices of what is made in place of a reconstruction; ``None``: it reconstructs.
    edits
        Edits of the people who were found, in the order in which they were made.
    character
        Digest of the character onto which everybody is retargeted, see ``pipeline.export.character.source``; ``None``:
        no retargeting.
    chunk_frames
        Output frames of one chunk, which is decoded and detected as one piece, of one camera.
    processes
        Number of processes, each with a single-threaded network of its own.

    Examples
    --------
    >>> config = ReconstructionConfig(exports=("bvh", "glb"), preset="blender")
    >>> config.exports, config.processes
    (('bvh', 'glb'), 1)
    """

    tracking: Mapping[str, float] = field(default_factory=dict)
    clustering: Mapping[str, float] = field(default_factory=dict)
    making: CalibrationChoices | ProxyChoices | VisualChoices | None = None
    edits: tuple[PeopleEdit, ...] = ()
    blurs_videos: bool = False  # Copies of the videos with blurred heads are made, for players
    is_remade: bool = False  # Files of people who were reconstructed before are made again
    character: str | None = None
    chunk_frames: Annotated[
        int, About("Frames of a chunk", "Frames of a camera in one chunk; results do not depend on it.", minimum=1)
    ] = DEFAULT_CHUNK_FRAMES
    processes: Annotated[
        int, About("Processes", "Number of processes; results do not depend on it.", minimum=1, maximum=64)
    ] = 1

    def __repr__(self) -> str:
        names = (field.name for field in fields(self))
        changed = (name for name in names if getattr(self, name) != getattr(_DEFAULTS, name))
        return f"ReconstructionConfig({', '.join(f'{name}={getattr(self, name)!r}' for name in changed)})"

    @property
    def frames(self) -> range | None:
        """Output frames of the session to reconstruct; ``None``: all."""
        return None if self.frame_range is None else range(*self.frame_range)

    @property
    def people_edits(self) -> tuple[PeopleEdit, ...]:
        """Edits that change people's frames: who is who, and corrections of joints."""
        return of_motion(self.edits)

    @property
    def num_people(self) -> int | None:
        """Largest number of people; ``None``: everybody."""
        return None if self.people == "auto" else self.people

    @property
    def is_of_people(self) -> bool:
        """True if people are reconstructed, or visuals are made of people who were reconstructed."""
        return self.making is None or isinstance(self.making, VisualChoices)

    @property
    def uses_fields(self) -> bool:
        """True if people are found from part affinity fields, where there are videos."""
        network = NETWORKS.get(self.networks.body)
        return self.method == "clustering" and network is not None and network.leaves_fields

    @property
    def uses_colours(self) -> bool:
        """True if the colours of clothes are measured, where there are videos."""
        return self.is_of_people and self.method == "tracking" and self.appearance == "on"


_DEFAULTS = ReconstructionConfig()
plainly_annotated(ReconstructionConfig.__init__)


def method_warnings(config: ReconstructionConfig, has_videos: bool) -> tuple[Finding, ...]:
    """Warnings about choices for a session of videos or of keypoints."""
    found = []
    if config.method == "clustering" and not (has_videos and config.uses_fields):
        message = "Clustering has no part affinity fields here. It connects joints that one detection has together."
        found.append(Finding(BODIES_CLUSTERED, message))
    if config.overlay and not has_videos:
        message = "Overlay videos need videos; a capture of keypoints has none."
        found.append(Finding(OVERLAY_WITHOUT_VIDEOS, message))
    return tuple(found)


CHOICES = {choice.name: choice for choice in declared_choices(JobChoices)}
"""Choices of jobs by name."""
NETWORKS = cast(Mapping[Detector, Network], named_values(Detector, Network))
"""Detector networks by name, which find people in whole images."""

JointsOfBody = Literal["body", "feet", "whole"]
PROFILES = cast(Mapping[Profile, Value], named_values(Profile, Value))  # by name
JOINTS: tuple[JointsOfBody, ...] = get_args(JointsOfBody)
"""Values of the choice ``joints`` that name joints."""


@dataclass(frozen=True, slots=True)
class Networks:
    """Networks of a reconstruction by their names in ``pipeline.detection.entries``."""

    body: str  # Network that finds bodies in whole images
    # Network that reads joints, heels and toes in the crop of each body; ``None`` without crops
    near: str | None = None
    hand: str | None = None  # Network that reads fingers in the crop of each hand; ``None`` without fingers
    # True if ``near`` refines the joints of the body; otherwise it adds heels and toes alone
    refines_body: bool = False
    # Network that reads the joints of leaning bodies again, in crops that 3D places; ``None``: no second detection
    again: str | None = None
    is_sized: bool = False  # True if the size of the images for ``body`` follows the size of the people in them

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all networks, which have to be installed."""
        return tuple(name for name in dict.fromkeys((self.body, self.near, self.hand, self.again)) if name)


@dataclass(frozen=True, slots=True)
class _ProfileNetworks:
    body: str
    near: str
    refines_body: bool
    joints: JointsOfBody


_PROFILES: Mapping[Profile, _ProfileNetworks] = {
    "fast": _ProfileNetworks("movenet-multipose-int8", "blazepose-full", refines_body=False, joints="body"),
    "balanced": _ProfileNetworks("movenet-multipose-int8", "blazepose-full", refines_body=True, joints="feet"),
    "accurate": _ProfileNetworks("movenet-multipose", "blazepose-heavy", refines_body=True, joints="feet"),
}
_HAND = "mediapipe-hand"


def _networks_of_profiles() -> tuple[str, ...]:
    choices = (JobChoices(profile=profile, joints=joints) for profile in PROFILES for joints in JOINTS)
    return tuple(dict.fromkeys(name for choice in choices for name in choice.networks.names))


NETWORKS_OF_PROFILES = _networks_of_profiles()
"""Names of the networks of all profiles."""
