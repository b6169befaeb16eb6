"""`multicap benchmark live --outputs`: delay that outputs add to a capture, and until a receiver gets an instant."""

import json
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from subprocess import PIPE, Popen
from typing import Any

from api.cli.benchmark.tracking import crowd
from api.cli.console import shows_help
from pipeline.core.runtime.child_processes import module_command

if not shows_help():
    import numpy as np

    from pipeline.run.live.capture import LiveCapture
    from pipeline.run.live.outputs.runner import LiveOutputs
    from pipeline.run.live.records import recorded_frames
    from pipeline.run.live.settings import LiveSettings

_NUM_CAMERAS, _NUM_PEOPLE, _RATE_HZ, _LEARN_S = 5, 4, 60.0, 1.0
_HOST, _ROUNDS = "127.0.0.1", 3
# Cases by name: whether there are outputs, what the receiver of the server does, and connections that come and go.
_CASES = {
    "no output": (False, "read", 0),
    "three outputs": (True, "read", 0),
    "one receiver hangs": (True, "hang", 0),
    "100 receivers come and go": (True, "read", 100),
}


def measure_outputs(duration_s: float, rounds: int = _ROUNDS) -> list[dict[str, Any]]:
    """Delays of each case, which are measured by turns: other programs on the machine delay all alike."""
    simulation = crowd(_NUM_CAMERAS, _NUM_PEOPLE, duration_s, _RATE_HZ)
    delays_s: dict[str, list[tuple[float, float]]] = {name: [] for name in _CASES}
    dropped, cpu_s = dict.fromkeys(_CASES, 0), dict.fromkeys(_CASES, 0.0)
    for _ in range(rounds):
        for name, case in _CASES.items():
            before_s = time.process_time()
            delays, num_dropped = _play(simulation, *case)
            cpu_s[name] += time.process_time() - before_s
            delays_s[name] += delays
            dropped[name] += num_dropped
    rows = []
    for name, delays in delays_s.items():
        capture_ms, received_ms = 1e3 * np.array(delays).T
        row = {
            "case": name,
            "instants": len(delays),
            "dropped": dropped[name],
            "cpu_ms": 1e3 * cpu_s[name] / len(delays),
        }
        row |= {f"capture_p{share}_ms": float(np.percentile(capture_ms, share)) for share in (50, 99)}
        has_arrived = np.isfinite(received_ms).any()
        for share in (50, 99):
            row[f"received_p{share}_ms"] = float(np.nanpercentile(received_ms, share)) if has_arrived else None
        rows.append(row)
    return rows


def _play(simulation: Any, has_outputs: bool, kind: str, num_connections: int) -> tuple[list[tuple[float, float]], int]:
    """Play frames at their pace; return of each instant with skeletons the delays, and the number of dropped ones.

    Delays are the time from the arrival of its last frame until all outputs have the instant, and from then until the
    receiver of VMC has it.
    """
    capture = LiveCapture(simulation.cameras, simulation.joints, LiveSettings(_RATE_HZ, learn_s=_LEARN_S))
    frames = recorded_frames(simulation.cameras, simulation.times, simulation.detections)
    vmc_port, osc_port, server_port = _free_ports(3)
    addresses = [f"vmc://{_HOST}:{vmc_port}", f"osc://{_HOST}:{osc_port}", f"qtm://:{server_port}"]
    shown: dict[float, tuple[float, float]] = {}
    with ExitStack() as opened:
        outputs = opened.enter_context(LiveOutputs(addresses if has_outputs else []))
        outputs.begin(simulation.joints.names, _RATE_HZ)
        words = vmc_port, num_connections, kind, server_port + 1 if has_outputs else 0
        arrivals = opened.enter_context(_receivers(*map(str, words)))
        start_s = time.monotonic() - frames[0].time_s
        for frame in frames:
            time.sleep(max(0.0, start_s + frame.time_s - time.monotonic()))
            began_s = time.monotonic()
            instants = capture.push(*frame)
            for instant in instants:
                outputs.show(instant)
                now_s = time.monotonic()
                if any(person.skeleton is not None for person in instant.people):
                    shown[float(np.float32(instant.time_s))] = now_s - began_s, now_s
        num_dropped = sum(output.dropped for output in outputs.statuses)
    return [(taken_s, arrivals.get(at, np.nan) - now_s) for at, (taken_s, now_s) in shown.items()], num_dropped


@contextmanager
def _receivers(*words: str) -> Iterator[Mapping[float, float]]:
    """Receivers in a process; behind the block the mapping has the arrival of each instant."""
    arrivals: dict[float, float] = {}
    command = module_command("api.cli.benchmark.receivers", *words)
    with Popen(command, stdin=PIPE, stdout=PIPE) as process:  # noqa: S603 - our own program
        assert process.stdout is not None  # noqa: S101 - it is a pipe
        process.stdout.readline()
        yield arrivals
        arrivals |= dict(json.loads(process.communicate()[0]))


def _free_ports(num_ports: int) -> list[int]:
    with ExitStack() as opened:
        bound = [opened.enter_context(socket.create_server((_HOST, 0))) for _ in range(num_ports)]
        return [server.getsockname()[1] for server in bound]
