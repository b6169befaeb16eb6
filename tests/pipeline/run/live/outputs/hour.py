"""``python -P -m tests.pipeline.run.live.outputs.hour --minutes 60``: memory of a live capture with all outputs.

Four people of the test pattern, with fingers, come at 60 Hz, or with ``--keypoints`` four people of five simulated
cameras through the whole capture; the outputs of all protocols have receivers that read, in a process of their own.
Each minute a line has the anonymous memory of the capture, and what was sent, dropped and read so far.
"""

import argparse
import itertools
import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from subprocess import PIPE, Popen

from api.cli.benchmark.tracking import crowd
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.outputs.pattern import LAYOUT, pattern_instants
from pipeline.run.live.outputs.runner import LiveOutputs
from pipeline.run.live.records import LiveInstant, RecordedFrame, recorded_frames
from pipeline.run.live.settings import LiveSettings
from tests.pipeline.run.live.outputs.receivers import NUM_PEOPLE, OutputReceiver, receivers

RATE_HZ, NUM_CAMERAS, LAP_S = 60.0, 5, 10.0
# A capture that is so late leaves frames out, as a live capture does.
MAX_LATE_S = 0.5


def resident_kib() -> int:
    """Anonymous memory of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))


def forth_and_back(frames: list[RecordedFrame]) -> Iterator[RecordedFrame]:
    """Frames without end: the recording forward, then backward."""
    last_s, period_s = frames[-1].time_s, 1 / RATE_HZ
    backward = sorted((f._replace(time_s=last_s + period_s - f.time_s) for f in frames), key=lambda f: f[1::-1])
    for lap in itertools.count():
        start_s = lap * (last_s + period_s)
        for frame in backward if lap % 2 else frames:
            yield frame._replace(time_s=start_s + frame.time_s)


def of_keypoints() -> tuple[tuple[str, ...], Iterator[tuple[int, LiveInstant]]]:
    """Instants of a capture at their pace, each with the number of frames that were left out."""
    simulation = crowd(NUM_CAMERAS, NUM_PEOPLE, LAP_S, RATE_HZ)
    capture = LiveCapture(simulation.cameras, simulation.joints, LiveSettings(RATE_HZ, learn_s=1.0))
    frames = recorded_frames(simulation.cameras, simulation.times, simulation.detections)

    def instants() -> Iterator[tuple[int, LiveInstant]]:
        num_late, start_s = 0, time.monotonic()
        for frame in forth_and_back(frames):
            late_s = time.monotonic() - start_s - frame.time_s
            if late_s > MAX_LATE_S:
                num_late += 1
                continue
            time.sleep(max(0.0, -late_s))
            for instant in capture.push(*frame):
                yield num_late, instant

    return simulation.joints.names, instants()


def of_pattern() -> tuple[tuple[str, ...], Iterator[tuple[int, LiveInstant]]]:
    """Instants of the test pattern, with fingers, at their pace, each with the number that was left out."""

    def instants() -> Iterator[tuple[int, LiveInstant]]:
        instant_at, start_s, number = pattern_instants(NUM_PEOPLE), time.monotonic(), 0
        for num_shown in itertools.count():
            yield number - num_shown, instant_at(number)
            number = max(number + 1, int((time.monotonic() - start_s) * RATE_HZ))
            time.sleep(max(0.0, start_s + number / RATE_HZ - time.monotonic()))

    return LAYOUT.joints.names, instants()


def read_all(receiver: OutputReceiver, name: str, counts: Counter[str]) -> None:
    """Read instants; decode one a second."""
    receiver.connect()
    for number in itertools.count():
        try:
            content = receiver.read()
        except TimeoutError:
            counts[f"{name} timeouts"] += 1
            continue
        counts[name] += 1
        if number % int(RATE_HZ) == 0:
            counts[f"{name} people"] = len(receiver.decode(content))


def receive() -> None:
    """Receive until stdin is closed; print counts at each line of stdin."""
    counts: Counter[str] = Counter()
    with ExitStack() as opened:
        by_name = {name: opened.enter_context(receiver) for name, receiver in receivers().items()}
        print(json.dumps([receiver.address for receiver in by_name.values()]), flush=True)  # noqa: T201
        for number, line in enumerate(sys.stdin):
            if not number:
                for name, receiver in by_name.items():
                    threading.Thread(target=read_all, args=(receiver, name, counts), daemon=True).start()
            print(json.dumps([counts, resident_kib()]) if line else "", flush=True)  # noqa: T201


def main(minutes: float, has_keypoints: bool) -> None:
    """Capture, and print a line each minute."""
    joints, instants = (of_keypoints if has_keypoints else of_pattern)()
    command = [sys.executable, "-P", "-m", __spec__.name if __spec__ else __name__, "--receive"]
    with Popen(command, stdin=PIPE, stdout=PIPE, text=True) as process, ExitStack() as opened:
        assert process.stdin is not None
        assert process.stdout is not None
        outputs = opened.enter_context(LiveOutputs(json.loads(process.stdout.readline()), allow_network=True))
        outputs.begin(joints, RATE_HZ)
        start_s, next_s, is_connected = time.monotonic(), 0.0, False
        for num_instants, (num_late, instant) in enumerate(instants, 1):
            outputs.show(instant)
            now_s = time.monotonic()
            if now_s >= next_s and len(instant.people) == NUM_PEOPLE and instant.people[-1].skeleton is not None:
                next_s = now_s + (60.0 if is_connected else 20.0)
                process.stdin.write("\n")
                process.stdin.flush()
                counts, receivers_kib = json.loads(process.stdout.readline())
                is_connected = True
                states = {o.address.partition(":")[0]: (o.state, o.sent, o.dropped, o.failed) for o in outputs.statuses}
                line = {
                    "minute": round((now_s - start_s) / 60, 2),
                    "rss_anon_kib": resident_kib(),
                    "receivers_kib": receivers_kib,
                    "instants": num_instants,
                    "left_out": num_late,
                    "outputs": states,
                    "read": counts,
                }
                print(json.dumps(line), flush=True)  # noqa: T201
            if now_s - start_s > 60 * minutes:
                break
        process.stdin.close()
        process.kill()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--keypoints", action="store_true")
    parser.add_argument("--receive", action="store_true")
    stated = parser.parse_args()
    receive() if stated.receive else main(stated.minutes, stated.keypoints)
