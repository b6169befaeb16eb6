"""The files that a reconstruction leaves, by name; the service's results bear the same names."""

from collections.abc import Collection, Iterator

from pipeline.config import Export
from pipeline.data import Reconstruction
from pipeline.export import bvh, c3d_file, csv_table, skeletons_json, trc
from pipeline.metrics.quality import encode as encode_metrics
from pipeline.metrics.quality import quality_report

DEFAULT_EXPORTS: tuple[Export, ...] = ("bvh",)


def result_files(
    reconstruction: Reconstruction, exports: Collection[Export] = DEFAULT_EXPORTS
) -> Iterator[tuple[str, bytes]]:
    """Names and contents of all result files, one at a time.

    Parameters
    ----------
    exports
        Formats of which everybody gets a file, beside the two files of all.
    """
    joints, timebase = reconstruction.joints, reconstruction.timebase
    yield "skeletons.json", skeletons_json.encode(reconstruction)
    yield "metrics.json", encode_metrics(quality_report(reconstruction))
    for track, motion in zip(reconstruction.tracks, reconstruction.motions, strict=True):
        if "bvh" in exports:
            yield f"{motion.name}.bvh", bvh.encode(motion)
        if "trc" in exports:
            yield f"{motion.name}.trc", trc.encode(track, joints, timebase, f"{motion.name}.trc")
        if "c3d" in exports:
            yield f"{motion.name}.c3d", c3d_file.encode(track, joints, timebase)
        if "csv" in exports:
            yield f"{motion.name}.csv", csv_table.encode(track, joints, timebase)
