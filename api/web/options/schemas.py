"""Bodies of ``GET /v1/options``: choices, profiles and networks."""

from collections.abc import Collection
from typing import Self

from pydantic import Field

from api.web.contract.schemas import ResponseModel
from pipeline.core.options.choices import Choice, Group, Kind
from pipeline.core.options.config import JointsOfBody, Profile
from pipeline.core.options.purposes import Purpose


class DetectorOut(ResponseModel):
    """Detector network that can be used alone, and whether it is installed."""

    name: str = Field(description="Value of `detector` in the spec of a job.")
    installed: bool | None = Field(
        description="Whether all ready workers have the detector; null while no worker is ready."
    )
    install: str = Field(description="Advice to the operator on the installation.")


class ProfileNetworksOut(ResponseModel):
    """Networks of a profile for some joints, and whether they are installed."""

    joints: JointsOfBody = Field(description="Value of `joints` in the spec of a job.")
    networks: tuple[str, ...] = Field(description="Names of the networks.")
    camera_frame_s: float | None = Field(
        description="Seconds that a job took for a frame of a camera when it was measured, on one core; null if it was "
        "not measured. Other machines are faster or slower."
    )
    installed: bool | None = Field(
        description="Whether all ready workers have the networks; null while no worker is ready."
    )
    install: str = Field(description="Advice to the operator on the installation.")


class ProfileOut(ResponseModel):
    """Profile: networks that find the 2D joints."""

    name: Profile = Field(description="Value of `profile` in the spec of a job.")
    default_joints: JointsOfBody = Field(description="Joints of the profile, where `joints` is `auto`.")
    joints: tuple[ProfileNetworksOut, ...] = Field(description="Networks by joints.")


class ValueOut(ResponseModel):
    """Named value of a choice."""

    name: str = Field(description="Value in the spec of a job.")
    label: str = Field(description="Label of the value for people.")
    note: str = Field(description="Further sentence, such as a measured cost; empty for none.")


class ChoiceOut(ResponseModel):
    """Choice of a job, as a field of a form."""

    name: str = Field(description="Name of the field in the spec of a job.")
    label: str = Field(description="Heading of the field in a form.")
    description: str = Field(description="Meaning of the choice, a sentence for people.")
    group: Group = Field(
        description="Part of a form: `purpose` of the files, `people`, `quality`, or `advanced` for all else."
    )
    kind: Kind = Field(
        description="`one` of the values, a list of `several` of them, a `flag`: true or false, a `number`, a "
        "`whole_number`, or a `frame_range`: a list of two whole numbers."
    )
    values: tuple[ValueOut, ...] = Field(
        description="Named values; for numbers, the names allowed in place of a number."
    )
    default: bool | str | float | tuple[str, ...] | None = Field(description="Default value.")
    unset: str | None = Field(description="Meaning of null, if null is the default.")
    minimum: float | None = Field(description="Smallest number.")
    exclusive_minimum: float | None = Field(description="Number that the value must exceed.")
    maximum: float | None = Field(description="Largest number.")

    @classmethod
    def of(cls, choice: Choice, missing: Collection[str] = ()) -> Self:
        """Build the response from a choice; ``missing`` are values that are not offered, as a package is missing."""
        about = choice.about
        return cls(
            name=choice.name,
            label=about.label,
            description=about.sentence,
            group=about.group,
            kind=choice.kind,
            values=tuple(
                ValueOut(name=name, label=value.label, note=value.note)
                for name, value in choice.values.items()
                if name not in missing
            ),
            default=choice.default,
            unset=about.unset,
            minimum=about.minimum,
            exclusive_minimum=about.above,
            maximum=about.maximum,
        )


class PurposeOut(ResponseModel):
    """Purpose of a take, and the choices of a job that files for it need."""

    name: str = Field(description="Name of the purpose.")
    label: str = Field(description="Label of the purpose for people.")
    note: str = Field(description="Sentence that tells which files it gives.")
    spec: dict[str, str | tuple[str, ...]] = Field(description="Fields of the spec of a job, with their values.")

    @classmethod
    def of(cls, purpose: Purpose) -> Self:
        """Build the response from a purpose."""
        return cls(name=purpose.name, label=purpose.label, note=purpose.note, spec=purpose.spec)


class Options(ResponseModel):
    """Choices of a job, profiles and detector networks."""

    profiles: tuple[ProfileOut, ...] = Field(description="All profiles, with their networks.")

    detectors: tuple[DetectorOut, ...] = Field(description="All detectors that the service supports.")
    choices: tuple[ChoiceOut, ...] = Field(
        description="All choices of a job, for a form. `callback_url` and `character` are not listed."
    )
    purposes: tuple[PurposeOut, ...] = Field(
        description="Purposes of a take, for a form; each sets the same choices, the first one to their defaults."
    )


class SampleFileOut(ResponseModel):
    """File of the sample capture."""

    name: str = Field(description="Name of the file.")
    media_type: str = Field(description="Content type of the file.")
    num_bytes: int = Field(description="Size of the file.")
    link: str = Field(description="Path of the file.")


class SampleOut(ResponseModel):
    """Sample capture: a real take to try the service with."""

    installed: bool = Field(description="Whether the machine of the web API has the sample capture.")
    install: str = Field(description="Advice to the operator on the installation.")
    attribution: str = Field(description="Source and licence, to show with the capture.")
    files: tuple[SampleFileOut, ...] = Field(description="Videos and calibration; none if it is not installed.")
