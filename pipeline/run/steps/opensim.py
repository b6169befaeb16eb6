"""Scale OpenSim's model to people and find its motion. The output indexes the files, with figures of each person."""

from pipeline.core.options.file_formats import FILE_FORMATS
from pipeline.run.engine.stage import OPENSIM, TAKE, Context, Output, ResultFile, Task, declared, indexed


@declared(
    OPENSIM,
    "Running OpenSim",
    cut="people",
    frames_a_part=1,  # OpenSim takes much longer than a task without a person
    follows=TAKE,
    choices=("exports", "output_rate_hz", "mass_kg", "names"),
    is_planned=lambda facts, config: config.making is None and "osim" in config.exports,
    is_reusable=False,
    makes_files=True,
)
def run_opensim(task: Task, context: Context) -> Output:
    """Write the archives of a part of the people."""
    from pipeline.export.opensim.model_files import write_opensim_files
    from pipeline.run.engine.take import assemble

    take = assemble(context)
    names = {motion.track_id: motion.name for motion in take.motions}
    files, people = [], []
    rate_hz = context.config.output_rate_hz
    for written in write_opensim_files(
        take, run_opensim.people(task), context.scratch, rate_hz, context.on_share(task)
    ):
        people.append(written.person.document())
        if written.path is not None:
            person, media_type = written.person.id, FILE_FORMATS["osim"].media_type
            files.append(ResultFile(written.path.name, "osim", person, media_type, written.path, names[person]))
    return indexed(files, people=people)
