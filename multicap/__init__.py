"""Multicap from Python: markerless motion capture of several people from calibrated cameras.

Reconstruct keypoints in this process; ``open_session`` takes videos in their place:

>>> import multicap
>>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
>>> config = multicap.ReconstructionConfig(exports=("bvh",))
>>> written = multicap.reconstruct_to_files(session, folder / "results", config)
>>> sorted({path.suffix for path in written.paths})
['.bvh', '.json']

or send it to a service:

>>> with multicap.Client.connect("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     job = client.submit("Take 1", [Path("cam01.mp4"), Path("cam02.mp4")], Path("Calib.qca.txt"))
...     job = client.follow(job, lambda job: print(f"{job['progress']:.0%}"))
...     client.download(job, Path("results"))

``docs/reference/python.md`` is the manual. Names are loaded at their first use: ``import multicap`` alone imports no
other package.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from api.cli.client import Client, Job, ServiceError
    from pipeline.calibration.contents import CameraFile
    from pipeline.calibration.formats import reader as calibration_reader
    from pipeline.calibration.reading import Reading as CalibrationReading
    from pipeline.calibration.registry import read_calibration
    from pipeline.calibration.validate import RawCamera
    from pipeline.capture.keypoint_files.keypoint_reader import reader as keypoint_reader
    from pipeline.capture.keypoint_files.people import KeypointsError
    from pipeline.capture.keypoint_files.points import KeypointReading
    from pipeline.capture.keypoints import KeypointSession, open_keypoints
    from pipeline.capture.own_points_file import with_own_points
    from pipeline.capture.points import PointSession
    from pipeline.capture.points import SessionMaker as Session
    from pipeline.capture.preflight_record import Recording
    from pipeline.capture.session import CaptureSession, open_session
    from pipeline.core.data.cameras import Camera
    from pipeline.core.data.detections import Detections
    from pipeline.core.data.reconstruction import Reconstruction
    from pipeline.core.data.rigid import Rigid3
    from pipeline.core.errors import ChildError, InputError, ModelError, PipelineError, Problem, SessionRefused
    from pipeline.core.options.choices import FileFormat
    from pipeline.core.options.config import ReconstructionConfig
    from pipeline.core.progress import Progress
    from pipeline.core.runtime.packages.samples import install as install_sample
    from pipeline.detection.models import install as install_network
    from pipeline.detection.models import install_networks
    from pipeline.export.character.source import CharacterSource
    from pipeline.export.opensim.installed import install as install_opensim_model
    from pipeline.export.results import WrittenResults, write_results
    from pipeline.export.writers.registry import PersonContent, Writer
    from pipeline.motion.body.installed import install as install_body
    from pipeline.run.engine.local import reconstruct, reconstruct_to_files
    from pipeline.run.live.capture import LiveCapture
    from pipeline.run.live.outputs.runner import LiveOutputs
    from pipeline.run.live.records import recorded_frames
    from pipeline.run.live.settings import LiveSettings, read_bodies

__all__ = [
    "CalibrationReading",
    "Camera",
    "CameraFile",
    "CaptureSession",
    "CharacterSource",
    "ChildError",
    "Client",
    "Detections",
    "FileFormat",
    "InputError",
    "Job",
    "KeypointReading",
    "KeypointSession",
    "KeypointsError",
    "LiveCapture",
    "LiveOutputs",
    "LiveSettings",
    "ModelError",
    "PersonContent",
    "PipelineError",
    "PointSession",
    "Problem",
    "Progress",
    "RawCamera",
    "Reconstruction",
    "ReconstructionConfig",
    "Recording",
    "Rigid3",
    "ServiceError",
    "Session",
    "SessionRefused",
    "Writer",
    "WrittenResults",
    "calibration_reader",
    "install_body",
    "install_network",
    "install_networks",
    "install_opensim_model",
    "install_sample",
    "keypoint_reader",
    "open_keypoints",
    "open_session",
    "read_bodies",
    "read_calibration",
    "reconstruct",
    "reconstruct_to_files",
    "recorded_frames",
    "with_own_points",
    "write_results",
]

__version__: str

# References of the names above for the interpreter; a test compares both.
_REFERENCES = {
    "CalibrationReading": "pipeline.calibration.reading:Reading",
    "Camera": "pipeline.core.data.cameras:Camera",
    "CameraFile": "pipeline.calibration.contents:CameraFile",
    "CaptureSession": "pipeline.capture.session:CaptureSession",
    "CharacterSource": "pipeline.export.character.source:CharacterSource",
    "ChildError": "pipeline.core.errors:ChildError",
    "Client": "api.cli.client:Client",
    "Detections": "pipeline.core.data.detections:Detections",
    "FileFormat": "pipeline.core.options.choices:FileFormat",
    "InputError": "pipeline.core.errors:InputError",
    "Job": "api.cli.client:Job",
    "KeypointReading": "pipeline.capture.keypoint_files.points:KeypointReading",
    "KeypointSession": "pipeline.capture.keypoints:KeypointSession",
    "KeypointsError": "pipeline.capture.keypoint_files.people:KeypointsError",
    "LiveCapture": "pipeline.run.live.capture:LiveCapture",
    "LiveOutputs": "pipeline.run.live.outputs.runner:LiveOutputs",
    "LiveSettings": "pipeline.run.live.settings:LiveSettings",
    "ModelError": "pipeline.core.errors:ModelError",
    "PersonContent": "pipeline.export.writers.registry:PersonContent",
    "PipelineError": "pipeline.core.errors:PipelineError",
    "PointSession": "pipeline.capture.points:PointSession",
    "Problem": "pipeline.core.errors:Problem",
    "Progress": "pipeline.core.progress:Progress",
    "RawCamera": "pipeline.calibration.validate:RawCamera",
    "Reconstruction": "pipeline.core.data.reconstruction:Reconstruction",
    "ReconstructionConfig": "pipeline.core.options.config:ReconstructionConfig",
    "Recording": "pipeline.capture.preflight_record:Recording",
    "Rigid3": "pipeline.core.data.rigid:Rigid3",
    "ServiceError": "api.cli.client:ServiceError",
    "Session": "pipeline.capture.points:SessionMaker",
    "SessionRefused": "pipeline.core.errors:SessionRefused",
    "Writer": "pipeline.export.writers.registry:Writer",
    "WrittenResults": "pipeline.export.results:WrittenResults",
    "calibration_reader": "pipeline.calibration.formats:reader",
    "install_body": "pipeline.motion.body.installed:install",
    "install_network": "pipeline.detection.models:install",
    "install_networks": "pipeline.detection.models:install_networks",
    "install_opensim_model": "pipeline.export.opensim.installed:install",
    "install_sample": "pipeline.core.runtime.packages.samples:install",
    "keypoint_reader": "pipeline.capture.keypoint_files.keypoint_reader:reader",
    "open_keypoints": "pipeline.capture.keypoints:open_keypoints",
    "open_session": "pipeline.capture.session:open_session",
    "read_bodies": "pipeline.run.live.settings:read_bodies",
    "read_calibration": "pipeline.calibration.registry:read_calibration",
    "reconstruct": "pipeline.run.engine.local:reconstruct",
    "reconstruct_to_files": "pipeline.run.engine.local:reconstruct_to_files",
    "recorded_frames": "pipeline.run.live.records:recorded_frames",
    "with_own_points": "pipeline.capture.own_points_file:with_own_points",
    "write_results": "pipeline.export.results:write_results",
}


def __getattr__(name: str) -> Any:
    """Load a name at its first use (PEP 562)."""
    if name == "__version__":
        return resolve_name("importlib.metadata:version")("multicap")
    if name not in _REFERENCES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = resolve_name(_REFERENCES[name])
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
