"""Multicap from Python: markerless motion capture of several people from calibrated cameras.

Reconstruct a capture in this process:

>>> import multicap
>>> session = multicap.open_session(Path("videos"), Path("Calib.qca.txt"))  # doctest: +SKIP
>>> config = multicap.ReconstructionConfig(frame_range=(0, 100))  # doctest: +SKIP
>>> multicap.reconstruct_to_files(session, Path("results"), config)  # doctest: +SKIP

or send it to a service:

>>> with multicap.Client.connect("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     job = client.submit("Take 1", [Path("cam01.mp4"), Path("cam02.mp4")], Path("Calib.qca.txt"))
...     job = client.follow(job, lambda job: print(f"{job['progress']:.0%}"))
...     client.download(job, Path("results"))

``docs/python.md`` is the manual. Names are loaded at their first use: ``import multicap`` alone imports no other
package.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from api.cli.client import Client, Job, ServiceError
    from pipeline.body.installed import install as install_body
    from pipeline.capture.keypoints import KeypointSession, open_keypoints
    from pipeline.capture.recordings import Recording
    from pipeline.capture.session import CaptureSession, open_session
    from pipeline.character.source import CharacterSource
    from pipeline.config import ReconstructionConfig
    from pipeline.data.reconstruction import Reconstruction
    from pipeline.detect.models import install as install_network
    from pipeline.detect.models import install_networks
    from pipeline.errors import ChildError, InputError, ModelError, PipelineError, Problem, SessionRefused
    from pipeline.export.results import WrittenResults, write_results
    from pipeline.live.bodies import read_bodies
    from pipeline.live.capture import LiveCapture
    from pipeline.live.recorded import recorded_frames
    from pipeline.live.settings import LiveSettings
    from pipeline.live.vmc import VmcSender
    from pipeline.opensim.installed import install as install_opensim_model
    from pipeline.progress import Progress
    from pipeline.runtime.packages.samples import install as install_sample
    from pipeline.stages.local import reconstruct, reconstruct_to_files

__all__ = [
    "CaptureSession",
    "CharacterSource",
    "ChildError",
    "Client",
    "InputError",
    "Job",
    "KeypointSession",
    "LiveCapture",
    "LiveSettings",
    "ModelError",
    "PipelineError",
    "Problem",
    "Progress",
    "Reconstruction",
    "ReconstructionConfig",
    "Recording",
    "ServiceError",
    "SessionRefused",
    "VmcSender",
    "WrittenResults",
    "install_body",
    "install_network",
    "install_networks",
    "install_opensim_model",
    "install_sample",
    "open_keypoints",
    "open_session",
    "read_bodies",
    "reconstruct",
    "reconstruct_to_files",
    "recorded_frames",
    "write_results",
]

# References of the names above for the interpreter; a test compares both.
_REFERENCES = {
    "CaptureSession": "pipeline.capture.session:CaptureSession",
    "CharacterSource": "pipeline.character.source:CharacterSource",
    "ChildError": "pipeline.errors:ChildError",
    "Client": "api.cli.client:Client",
    "InputError": "pipeline.errors:InputError",
    "Job": "api.cli.client:Job",
    "KeypointSession": "pipeline.capture.keypoints:KeypointSession",
    "LiveCapture": "pipeline.live.capture:LiveCapture",
    "LiveSettings": "pipeline.live.settings:LiveSettings",
    "ModelError": "pipeline.errors:ModelError",
    "PipelineError": "pipeline.errors:PipelineError",
    "Problem": "pipeline.errors:Problem",
    "Progress": "pipeline.progress:Progress",
    "Reconstruction": "pipeline.data.reconstruction:Reconstruction",
    "ReconstructionConfig": "pipeline.config:ReconstructionConfig",
    "Recording": "pipeline.capture.recordings:Recording",
    "ServiceError": "api.cli.client:ServiceError",
    "SessionRefused": "pipeline.errors:SessionRefused",
    "VmcSender": "pipeline.live.vmc:VmcSender",
    "WrittenResults": "pipeline.export.results:WrittenResults",
    "install_body": "pipeline.body.installed:install",
    "install_network": "pipeline.detect.models:install",
    "install_networks": "pipeline.detect.models:install_networks",
    "install_opensim_model": "pipeline.opensim.installed:install",
    "install_sample": "pipeline.runtime.packages.samples:install",
    "open_keypoints": "pipeline.capture.keypoints:open_keypoints",
    "open_session": "pipeline.capture.session:open_session",
    "read_bodies": "pipeline.live.bodies:read_bodies",
    "reconstruct": "pipeline.stages.local:reconstruct",
    "reconstruct_to_files": "pipeline.stages.local:reconstruct_to_files",
    "recorded_frames": "pipeline.live.recorded:recorded_frames",
    "write_results": "pipeline.export.results:write_results",
}


def __getattr__(name: str) -> Any:
    """Load a name at its first use (PEP 562)."""
    if name not in _REFERENCES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = resolve_name(_REFERENCES[name])
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
