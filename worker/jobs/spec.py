"""What a client may ask for."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator
from pydantic_core import PydanticCustomError, PydanticKnownError

# Networks with part affinity fields; the others find whole bodies.
_FIELD_DETECTORS = frozenset({"openpose-mobilenet-thin", "human-pose-estimation-0001"})


# Commands that install a missing detector; as ``pipeline.detect.models`` says it.
INSTALL_COMMANDS: Mapping[str, str] = {
    "movenet-multipose": "Run: multicap models install movenet-multipose",
    "openpose-mobilenet-thin": "Run: multicap models install openpose-mobilenet-thin",
    "human-pose-estimation-0001": (
        "Get it from Intel's Open Model Zoo (FP16-INT8), then run: "
        "multicap models add human-pose-estimation-0001 --from FOLDER or URL"
    ),
}

# As in ``pipeline.export.c3d_file``.
_MAX_C3D_FRAMES = 2**16 - 1
# As in ``pipeline.quantities``.
_MAX_OUTPUT_FRAMES = 1_000_000


def _number(value: object) -> object:
    # Strict integers would refuse 2.0 too, which is a whole number in JSON.
    if isinstance(value, bool | str):
        raise PydanticKnownError("int_type")
    return value


# Numbers are numbers: true is no 1, and "1" neither.
_FrameNumber = Annotated[int, Field(ge=0), BeforeValidator(_number)]


class JobSpec(BaseModel):
    """A reconstruction's choices. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Literal["tracking", "clustering"] = Field(default="tracking", description="How detections become tracks.")
    detector: Literal["movenet-multipose", "openpose-mobilenet-thin", "human-pose-estimation-0001"] = Field(
        default="movenet-multipose",
        description="The 2D joint detector. With `clustering` the latter two give part affinity fields as evidence.",
    )

    smoothing: Literal["none", "butterworth", "one-euro", "fit"] = Field(
        default="fit", description="What becomes of the joints' positions."
    )
    cutoff_hz: float = Field(
        default=6.0,
        strict=True,
        gt=0.0,
        le=1000.0,
        allow_inf_nan=False,
        description="Of `butterworth`, below half the frame rate.",
    )
    feet: Literal["off", "auto", "always"] = Field(
        default="auto",
        description="Which feet that stand are held in place: none, where it is likely that they stand, or all.",
    )

    frame_range: tuple[_FrameNumber, _FrameNumber] | None = Field(
        default=None,
        description="The first of the session's output frames, and the one after the last; all without it.",
    )
    output_rate_hz: float | None = Field(
        default=None,
        strict=True,
        ge=1.0,
        le=240.0,
        allow_inf_nan=False,
        description="Frame rate of the motion in all files; without it the session's, which metrics are of anyway.",
    )
    people: Literal["auto"] | Annotated[int, Field(ge=1, le=1000), BeforeValidator(_number)] = Field(
        default="auto", description="How many at most: those whom most cameras saw for longest. `auto`: everybody."
    )

    exports: tuple[Literal["bvh", "glb", "trc", "c3d", "csv"], ...] = Field(
        default=("bvh",),
        description="Formats of which each person gets a file, beside `skeletons.json` and `metrics.json`.",
        json_schema_extra={"uniqueItems": True},
    )

    bvh: Literal["default", "blender", "unity-humanoid", "unreal", "mixamo"] = Field(
        default="default", description="What BVH files are to be opened with: their names, axes, unit and rest pose."
    )

    callback_url: str | None = Field(
        default=None,
        max_length=2000,
        pattern=r"^https?://[^\s/?#@\\]+([/?][^\s#\\]*)?$",
        examples=["https://portal.example/hooks/multicap"],
        description="Told of the job's end by a Standard Webhook: `job.succeeded`, `.failed`, `.canceled`, `.expired`.",
    )

    @field_validator("exports")
    @classmethod
    def _each_once(cls, exports: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(exports)) < len(exports):
            raise PydanticCustomError("export_repeated", "exports must name each format once.")
        return exports

    def problems(self, num_frames: int, frame_rate_hz: float) -> dict[str, tuple[str, str]]:
        """What of this can't be done with a session of so many output frames: code and sentence by field."""
        found = {}
        if self.frame_range is not None:
            start, stop = self.frame_range
            if not start < stop <= num_frames:
                message = f"The session has the output frames 0 to {num_frames}; the second number is after the last."
                found["frame_range"] = "frame_range", message
            else:
                num_frames = stop - start
        if self.smoothing == "butterworth" and self.cutoff_hz >= frame_rate_hz / 2:
            message = f"The cutoff must be below half of the session's frame rate, {frame_rate_hz / 2:g} Hz."
            found["cutoff_hz"] = "cutoff_range", message
        if self.output_rate_hz is not None:
            num_frames = round((num_frames - 1) * self.output_rate_hz / frame_rate_hz) + 1
            if num_frames > _MAX_OUTPUT_FRAMES:
                message = (
                    f"At this rate the session has {num_frames:,} frames; at most {_MAX_OUTPUT_FRAMES:,} are written. "
                    "Ask for a lower rate, or for fewer frames by frame_range."
                )
                found["output_rate_hz"] = "too_many_frames", message
        if "c3d" in self.exports and num_frames > _MAX_C3D_FRAMES:
            message = f"A C3D file holds {_MAX_C3D_FRAMES} frames at most; these are {num_frames}. Use trc or csv."
            found["exports"] = "too_long_for_c3d", message
        return found

    @property
    def frames(self) -> range | None:
        """``frame_range`` as a range."""
        return None if self.frame_range is None else range(*self.frame_range)

    @property
    def uses_fields(self) -> bool:
        """Whether people are found from part affinity fields, where there are videos."""
        return self.method == "clustering" and self.detector in _FIELD_DETECTORS

    def warnings(self, of_keypoints: bool) -> tuple[str, ...]:
        """What a client should know of these choices, a sentence each.

        Parameters
        ----------
        of_keypoints
            Whether there are keypoints instead of videos, and so no detector.
        """
        if self.method == "clustering" and (of_keypoints or not self.uses_fields):
            return (
                "Clustering takes whole bodies for evidence: two joints are connected where one detection has both.",
            )
        return ()
