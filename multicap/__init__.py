"""Multicap from Python: markerless motion capture of several people from calibrated cameras.

Reconstruct a capture in this process:

>>> import multicap
>>> session = multicap.open_session(Path("videos"), Path("Calib.qca.txt"))  # doctest: +SKIP
>>> config = multicap.ReconstructionConfig(frames=range(100))  # doctest: +SKIP
>>> reconstruction = multicap.reconstruct(session, config)  # doctest: +SKIP
>>> multicap.write_results(reconstruction, Path("results"), exports=["bvh", "glb"])  # doctest: +SKIP

or by a service:

>>> with multicap.Client.connect("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     job = client.submit("Take 1", [Path("cam01.mp4"), Path("cam02.mp4")], Path("Calib.qca.txt"))
...     job = client.follow(job, lambda job: print(f"{job['progress']:.0%}"))
...     client.download(job, Path("results"))

``docs/python.md`` is the manual. Names are loaded at their first use: ``import multicap`` alone loads no other package.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from api.client import Client, Job, ServiceError
    from api.commands.reconstruct import write_results
    from pipeline.config import ReconstructionConfig
    from pipeline.data import Reconstruction
    from pipeline.detect.models import install as install_detector
    from pipeline.errors import ChildError, InputError, ModelError, PipelineError, Problem
    from pipeline.keypoints import KeypointSession, open_keypoints
    from pipeline.progress import Progress
    from pipeline.run import reconstruct, reconstruct_keypoints
    from pipeline.samples import install as install_sample
    from pipeline.session import CaptureSession, Recording, open_session

__all__ = [
    "CaptureSession",
    "ChildError",
    "Client",
    "InputError",
    "Job",
    "KeypointSession",
    "ModelError",
    "PipelineError",
    "Problem",
    "Progress",
    "Reconstruction",
    "ReconstructionConfig",
    "Recording",
    "ServiceError",
    "install_detector",
    "install_sample",
    "open_keypoints",
    "open_session",
    "reconstruct",
    "reconstruct_keypoints",
    "write_results",
]

# The same as above, for the interpreter; a test compares them.
_REFERENCES = {
    "CaptureSession": "pipeline.session:CaptureSession",
    "ChildError": "pipeline.errors:ChildError",
    "Client": "api.client:Client",
    "InputError": "pipeline.errors:InputError",
    "Job": "api.client:Job",
    "KeypointSession": "pipeline.keypoints:KeypointSession",
    "ModelError": "pipeline.errors:ModelError",
    "PipelineError": "pipeline.errors:PipelineError",
    "Problem": "pipeline.errors:Problem",
    "Progress": "pipeline.progress:Progress",
    "Reconstruction": "pipeline.data:Reconstruction",
    "ReconstructionConfig": "pipeline.config:ReconstructionConfig",
    "Recording": "pipeline.session:Recording",
    "ServiceError": "api.client:ServiceError",
    "install_detector": "pipeline.detect.models:install",
    "install_sample": "pipeline.samples:install",
    "open_keypoints": "pipeline.keypoints:open_keypoints",
    "open_session": "pipeline.session:open_session",
    "reconstruct": "pipeline.run:reconstruct",
    "reconstruct_keypoints": "pipeline.run:reconstruct_keypoints",
    "write_results": "api.commands.reconstruct:write_results",
}


def __getattr__(name: str) -> Any:
    """Load a name at its first use (PEP 562)."""
    if name not in _REFERENCES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = resolve_name(_REFERENCES[name])
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
