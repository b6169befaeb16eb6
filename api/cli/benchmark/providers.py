"""`multicap benchmark providers`: joints and time of an execution provider, compared with the CPU's."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from api.cli.console import JsonOption, emit, print_table, reporting, shows_help
from api.cli.options import ProviderOption, take_provider
from pipeline.core.options.config import PROFILES, Networks, ReconstructionConfig
from pipeline.core.options.providers import ProviderName, choose_provider
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.detection.providers.find import current_provider

if not shows_help():
    import av
    import numpy as np
    from jaxtyping import Float, UInt8

    from pipeline.core.runtime.packages import samples
    from pipeline.detection import models
    from pipeline.detection.bodies import ImageBodies
    from pipeline.detection.entries import find_entry
    from pipeline.detection.profiles.profile_detector import open_detection

# One frame in so many, of each camera, up to a number.
_STEP, _NUM_FRAMES = 10, 12
_MIN_SCORE = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class _Detected:
    """Bodies of the pictures, and the time that they took."""

    bodies: "list[ImageBodies]"
    frame_ms: float


def providers(provider: ProviderOption = None, as_json: JsonOption = False) -> None:
    """Compare joints of an execution provider with the CPU's by profile, on pictures of the sample; time both."""
    with reporting(as_json):
        take_provider(provider)
        found = current_provider()
        videos = list(samples.install().videos.values())
        result: dict[str, dict[str, Any]] = {}
        for profile in PROFILES:
            config = ReconstructionConfig(profile=profile)
            models.install_networks(config)
            networks = config.networks
            twin = find_entry(networks.body).single_precision
            if found.is_gpu and twin is not None:
                networks = replace(networks, body=twin)
            detected = [_detect(name, networks, config, videos) for name in ("cpu", found.name)]
            result[profile] = _compared(*detected)
    if as_json:
        emit({"provider": found.name, "device": found.device, "profiles": result})
        return
    columns = tuple(next(iter(result.values())))
    rows = ((name, *(f"{row[key]:.4g}" for key in columns)) for name, row in result.items())
    print_table(("profile", *columns), rows, f"{found.name} {found.device}")


def _detect(provider: ProviderName, networks: Networks, config: ReconstructionConfig, videos: list[Path]) -> _Detected:
    """Detect bodies in pictures of videos, by a provider, in a process of its own."""
    with ProcessPool(1, choose_provider, (provider,)) as pool:
        return pool.submit(_detect_here, networks, config, videos).result()


def _detect_here(networks: Networks, config: ReconstructionConfig, videos: list[Path]) -> _Detected:
    detector = open_detection(networks, config.detected_joints)
    pictures = [picture for video in videos for picture in sample_pictures(video)]
    detector.detect(pictures[0])
    started_s = time.perf_counter()
    bodies = [detector.detect(picture) for picture in pictures]
    return _Detected(bodies, (time.perf_counter() - started_s) / len(pictures) * 1000)


def sample_pictures(video: Path) -> 'list[UInt8[np.ndarray, "height width 3"]]':
    """Pictures of a video, evenly spread over its beginning."""
    with av.open(str(video)) as container:
        decoded = (frame for number, frame in enumerate(container.decode(video=0)) if number % _STEP == 0)
        return [frame.to_ndarray(format="rgb24") for frame, _ in zip(decoded, range(_NUM_FRAMES), strict=False)]


def _compared(on_cpu: _Detected, by_provider: _Detected) -> dict[str, Any]:
    """Distances between the joints of both, of bodies that both found in the same order."""
    pairs = list(zip(on_cpu.bodies, by_provider.bodies, strict=True))
    alike = [(first, second) for first, second in pairs if first.score.shape == second.score.shape]
    distances_px = np.concatenate([_distances_px(first, second) for first, second in alike])
    return {
        "cpu_ms": on_cpu.frame_ms,
        "provider_ms": by_provider.frame_ms,
        "pictures": len(pairs),
        "with_other_bodies": len(pairs) - len(alike),
        "joints": len(distances_px),
        "median_px": float(np.median(distances_px)),
        "p99_px": float(np.percentile(distances_px, 99)),
        "max_px": float(distances_px.max()),
    }


def _distances_px(first: "ImageBodies", second: "ImageBodies") -> 'Float[np.ndarray, " joints"]':
    distances_px = np.linalg.norm(first.keypoints_px - second.keypoints_px, axis=-1)
    return distances_px[(first.score >= _MIN_SCORE) & np.isfinite(distances_px)]
