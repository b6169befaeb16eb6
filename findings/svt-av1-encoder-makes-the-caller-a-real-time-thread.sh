#!/usr/bin/env bash
# PyAV with SVT-AV1, as root on Linux: encoding a video leaves the calling thread under the real-time policy SCHED_FIFO.
# One guesses that an encoder that is closed leaves its caller as it was. libx264 and libvpx-vp9 do. After libsvtav1 the
# thread stays real-time, and programs that it starts inherit the policy: a browser or a pool of workers then keeps all
# other programs from the processors. Without the right to change the policy (not root) nothing changes.
set -euo pipefail
[ "$(uname)" = Linux ] && [ "$(id -u)" = 0 ] || { echo "run as root on Linux"; exit 1; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" 2>/dev/null <<'PYTHON'
import os
import subprocess
import sys

import av
import numpy as np

POLICIES = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO"}
SHOW = "import os; print(os.sched_getscheduler(0))"


def encode(codec: str) -> None:
    """Write four black pictures."""
    with av.open(f"{sys.argv[1]}/{codec}.mkv", "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width = stream.height = 128
        stream.pix_fmt = "yuv420p"
        for _ in range(4):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((128, 128, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode())


print("PyAV", av.__version__)
assert os.sched_getscheduler(0) == os.SCHED_OTHER, "start this program under the usual policy"
for codec, policy in (("libx264", os.SCHED_OTHER), ("libvpx-vp9", os.SCHED_OTHER), ("libsvtav1", os.SCHED_FIFO)):
    encode(codec)
    child = int(subprocess.run([sys.executable, "-c", SHOW], capture_output=True, check=True).stdout)
    print(f"after {codec}: this thread {POLICIES[os.sched_getscheduler(0)]}, a program that it starts {POLICIES[child]}")
    assert (os.sched_getscheduler(0), child) == (policy, policy), f"{codec} has changed its behaviour"
PYTHON
