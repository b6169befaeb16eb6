"""Purposes of a take: choices of a job for the software that reads its files. Standard library only."""

from dataclasses import dataclass, fields

from pipeline.core.options.config import JobChoices, Preset
from pipeline.core.options.file_formats import Export


@dataclass(frozen=True, slots=True)
class Purpose:
    """Purpose of a take: choices of a job that files for it need."""

    name: str
    label: str  # Name in forms and documentation
    note: str  # Sentence that tells which files it gives
    exports: tuple[Export, ...]
    preset: Preset = "default"

    @property
    def spec(self) -> dict[str, str | tuple[str, ...]]:
        """Choices of a job's spec that the purpose sets."""
        return {name: getattr(self, name) for name in CHOICES_OF_PURPOSES}


CHOICES_OF_PURPOSES = tuple(field.name for field in fields(Purpose) if field.name in JobChoices.__dataclass_fields__)
"""Choices that each purpose sets."""

PURPOSES = (
    Purpose("motion", "Any software", "BVH in standard names, which most software reads.", ("bvh",)),
    Purpose(
        "blender", "Blender", "BVH and FBX in names that Blender's symmetry tools know.", ("bvh", "fbx"), "blender"
    ),
    Purpose(
        "unreal",
        "Unreal Engine",
        "FBX and BVH in the names of the mannequin and of MetaHuman.",
        ("bvh", "fbx"),
        "unreal",
    ),
    Purpose("unity", "Unity", "FBX that Unity maps to a humanoid, and BVH.", ("bvh", "fbx"), "unity-humanoid"),
    Purpose(
        "maya",
        "Maya, MotionBuilder",
        "FBX that HumanIK characterises by its names, and BVH.",
        ("bvh", "fbx"),
        "humanik",
    ),
    Purpose(
        "character",
        "My own character",
        "GLB, FBX and BVH of your character, beside the files of each person.",
        ("bvh", "glb", "fbx"),
    ),
    Purpose("vrm", "VRM characters", "VRMA, which every VRM character plays.", ("vrma",)),
    Purpose("web", "Web pages", "GLB with bodies and cameras, for three.js, Babylon.js and model viewers.", ("glb",)),
    Purpose(
        "research",
        "Biomechanics",
        "Joint positions as TRC, C3D and CSV; joint angles as CSV and MOT.",
        ("trc", "c3d", "csv", "angles", "mot"),
    ),
)
"""Purposes in the order of the form. The first one has the defaults."""
