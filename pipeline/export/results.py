"""The files that a reconstruction leaves, by name; the service's results bear the same names."""

from collections.abc import Iterator

from pipeline.data import Reconstruction
from pipeline.export import bvh, skeletons_json
from pipeline.metrics.quality import encode as encode_metrics
from pipeline.metrics.quality import quality_report


def result_files(reconstruction: Reconstruction) -> Iterator[tuple[str, bytes]]:
    """Names and contents of all result files, one at a time."""
    yield "skeletons.json", skeletons_json.encode(reconstruction)
    yield "metrics.json", encode_metrics(quality_report(reconstruction))
    for motion in reconstruction.motions:
        yield f"{motion.name}.bvh", bvh.encode(motion)
