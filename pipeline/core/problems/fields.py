"""Problem codes of fields: values that are wrong by themselves."""

from pipeline.core.problems.model import CodeGroup

_FIELD = ("422",)
# Of choices of a reconstruction, too, which the command line checks by the same rules.
_CHOICE = ("422", "command")

FIELDS = CodeGroup(
    "Fields and parameters",
    "Values of `code` in the `errors` of a response `invalid_request`; `pointer` leads to the field.",
)

UNKNOWN_FIELD = FIELDS.code(
    "unknown_field", ("422", "command"), "The object has no such field.", "Remove it or correct its name."
)
MISSING_FIELD = FIELDS.code("missing_field", _FIELD, "A required field or parameter is missing.", "Add it.")
MALFORMED_JSON = FIELDS.code(
    "malformed_json", ("400", "422"), "The body, or the part of the form, is not JSON.", "Send JSON."
)
WRONG_TYPE = FIELDS.code(
    "wrong_type", _CHOICE, "The value has a type that the field does not allow.", "Send the type in `message`."
)
VALUE_NOT_ALLOWED = FIELDS.code(
    "value_not_allowed", _CHOICE, "The value is not allowed.", "Send a value that `message` lists."
)
OUT_OF_RANGE = FIELDS.code(
    "out_of_range", _CHOICE, "The number is outside of its limits.", "Send a number within the limits."
)
WRONG_LENGTH = FIELDS.code(
    "wrong_length",
    _CHOICE,
    "The text or list is too short or too long.",
    "Send a text or list of the length that `message` states.",
)
WRONG_FORMAT = FIELDS.code(
    "wrong_format", _CHOICE, "The text does not have the required form.", "Use the form in `message`."
)
CONTROL_CHARACTERS = FIELDS.code("control_characters", _FIELD, "The text contains control characters.", "Remove them.")
JSON_VALUE = FIELDS.code(
    "json_value", _FIELD, "The value is not valid JSON: NaN, infinity or a lone surrogate.", "Remove it."
)
EXPORT_REPEATED = FIELDS.code(
    "export_repeated", _CHOICE, "A format is named twice in `exports`.", "Name each format once."
)
INVALID_VALUE = FIELDS.code("invalid_value", _CHOICE, "The value is wrong in another way.", "Read `message`.")
MORE_PROBLEMS = FIELDS.code(
    "more_problems",
    ("422", "command"),
    "There are more problems than the listed problems.",
    "Correct the listed problems first.",
)
