"""Form that creates characters."""

from collections.abc import Iterator, Mapping

from api.web.characters import examples
from api.web.characters.schemas import CharacterSpec, UploadedCharacter
from api.web.contract.examples import UPLOAD_IDS
from api.web.http.bodies.form_kinds import CHARACTER, SPEC, FormKind
from pipeline.core.problems.model import Code
from pipeline.core.problems.requests import MISSING_PART


def _faults(counts: Mapping[str, int]) -> Iterator[tuple[Code, str, str]]:
    if not counts[CHARACTER]:
        yield MISSING_PART, "There is no character: send its file, GLB, VRM or FBX.", CHARACTER


CHARACTER_FORM = FormKind(
    name="CharacterForm",
    noun="character",
    parts={CHARACTER: "File of the character: GLB (binary glTF 2.0) or VRM with everything inside, or binary FBX 7."},
    documents={SPEC: CharacterSpec},
    uploaded=UploadedCharacter,
    form_example={CHARACTER: "robot.vrm", SPEC: examples.SPEC},
    uploaded_example={CHARACTER: UPLOAD_IDS[0], **examples.SPEC},
    faults=_faults,
)
