"""Move a character of the user's own as the people of a take. The output is the index of its files."""

from pipeline.run.engine.stage import RETARGET, TAKE, Context, Output, ResultFile, Task, declared, indexed

KIND = "character"
"""Kind of the files among a job's files."""

_MEDIA_TYPES = {"glb": "model/gltf-binary", "bvh": "text/plain; charset=utf-8", "fbx": "application/octet-stream"}


@declared(
    RETARGET,
    "Animating the character",
    cut="whole",
    follows=TAKE,
    choices=("character", "exports", "output_rate_hz", "timeline", "names"),
    is_planned=lambda facts, config: config.making is None and config.character is not None,
    is_reusable=False,
    makes_files=True,
)
def retarget_character(task: Task, context: Context) -> Output:
    """Retarget everybody onto the character, and write their files."""
    from pipeline.export.character.character_files import DESCRIPTION, write_character_files
    from pipeline.run.engine.take import assemble

    config, take, folder, on_share = context.config, assemble(context), context.scratch, context.on_share(task)
    character = context.files.character().open()
    names = {motion.track_id: motion.name for motion in take.motions}
    choices = config.exports, config.output_rate_hz, config.timeline
    files = [
        ResultFile(file.path.name, KIND, file.track_id, _MEDIA_TYPES[file.export], file.path, names[file.track_id])
        for file in write_character_files(take, character, folder, *choices, on_share)
    ]
    files.append(ResultFile(DESCRIPTION, KIND, None, "application/json", folder / DESCRIPTION))
    return indexed(files)
