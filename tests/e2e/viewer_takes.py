"""Large takes for the viewer: one walker's motion, many times."""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from api.web.settings import Settings
from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.people import Doubt, Observations
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.views import person_views
from pipeline.export.viewer.description import Footage, ViewerMotion
from pipeline.export.viewer.frames import Arrows
from pipeline.motion.body.shape import BodyShapes
from pipeline.motion.skeleton.animate import animate
from tests.api.conftest import NO_BROKER, PREFLIGHT
from tests.pipeline.export.quality.test_report import CAMERAS, observe
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

_PERIOD_S = 2


def crowd(
    num_people: int, num_frames: int, rate_hz: float = 60.0, doubts: Sequence[Sequence[Doubt]] = ()
) -> Reconstruction:
    """People who walk on the spot in rows of five."""
    period = round(_PERIOD_S * rate_hz)
    xyz_m = walker(period, rate_hz)
    hips = COCO_17.indices(("left_hip", "right_hip"))
    xyz_m[..., 1] += 2.0 - xyz_m[:, hips, 1].mean(1, keepdims=True)
    step = track_of(xyz_m)
    animated = animate(
        (step,),
        (observe(step),),
        CAMERAS,
        Timebase(0.0, rate_hz, period),
        COCO_17,
        ReconstructionConfig(smoothing="none"),
    )
    rows = np.arange(num_frames) % period
    tracks, motions, observations = [], [], []
    for number in range(num_people):
        aside_m = np.array([0.9 * (number % 5), 1.1 * (number // 5), 0.0])
        track = replace(
            step,
            track_id=number + 1,
            xyz_m=step.xyz_m[rows] + aside_m,
            **{name: getattr(step, name)[rows] for name in ("score", "source", "error_px", "views")},
        )
        (motion,) = animated.motions
        tracks.append(track)
        motions.append(
            replace(
                motion,
                track_id=number + 1,
                name=f"person-{number + 1}",
                root_m=motion.root_m[rows] + aside_m,
                parent_from_joint=motion.parent_from_joint[rows],
            )
        )
        seen = observe(track)
        observations.append(Observations(number + 1, seen.points_px, seen.score))
    timebase = Timebase(0.0, rate_hz, num_frames)
    animation = Animation(tuple(tracks), tuple(motions), animated.floor)
    return Reconstruction(CAMERAS, COCO_17, timebase, tuple(tracks), tuple(observations), animation, doubts=doubts)


def viewer_files_of(
    reconstruction: Reconstruction, shapes: BodyShapes | None = None, arrows_m: Arrows = MappingProxyType({})
) -> dict[str, bytes]:
    """Files for viewers by name; bodies are humans if there are ``shapes``."""
    timebase = reconstruction.timebase
    times = FrameTimes(timebase.start_time_s + np.arange(timebase.num_frames) / timebase.frame_rate_hz)
    footage = {camera.name: Footage(times) for camera in reconstruction.cameras}
    views, report = person_views(reconstruction), json.loads(json.dumps(quality_report(reconstruction)))
    motion = ViewerMotion(reconstruction, views, footage, report, shapes=shapes, arrows_m=arrows_m)
    content = b"".join(motion.encode())
    return {"motion.bin": content, "motion.json": motion.describe()}


def quick_settings(folder: Path) -> Settings:
    """Settings of a service without a broker, which takes any file for a video: jobs are finished by tests."""
    script = folder / "preflight.py"
    script.write_text(PREFLIGHT, encoding="utf-8")
    command = (sys.executable, "-I", "-S", str(script))
    return Settings(data_dir=folder / "data", broker_url=NO_BROKER, preflight_command=command)
