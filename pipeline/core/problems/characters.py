"""Problem codes of characters: files with a skeleton of the user's own."""

from pipeline.core.problems.model import CodeGroup

_WHERE = ("422", "command")

CHARACTERS = CodeGroup(
    "Characters", "Characters of the user's own, onto which motion is retargeted; see [characters](characters.md)."
)

CHARACTER_FORMAT = CHARACTERS.code(
    "character_format",
    _WHERE,
    "The file is in a format that characters are not read from.",
    "Export the character as GLB (binary glTF 2.0), VRM or binary FBX 7.",
)
CHARACTER_UNREADABLE = CHARACTERS.code(
    "character_unreadable",
    _WHERE,
    "The file of the character is damaged, or breaks the rules of its format.",
    "Follow the message: export the character once more, as GLB with everything inside, or as binary FBX.",
)
CHARACTER_TOO_LARGE = CHARACTERS.code(
    "character_too_large",
    _WHERE,
    "The file of the character is larger, or has more nodes or vertices, than is read.",
    "Follow the message: leave out what is not the character, or use smaller pictures.",
)
CHARACTER_BONES = CHARACTERS.code(
    "character_bones",
    _WHERE,
    "Bones of the character are missing, or can't be turned.",
    "Follow the message, or state the bones by a table of bones.",
)
BONES_INVALID = CHARACTERS.code(
    "bones_invalid",
    _WHERE,
    "The table of bones can't be used.",
    "Correct it: each joint of the skeleton names a bone of the character, or null.",
)
