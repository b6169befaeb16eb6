"""Lost network of two outputs: the others and the capture continue as before.

The capture runs in a network of its own, joined to the network of a receiver, which is taken away for some seconds.
``python -P -m tests.pipeline.run.live.outputs.test_lost_network 10`` prints the delays for ten seconds.
"""

import json
import socket
import struct
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest

from pipeline.run.live.outputs.pattern import LAYOUT, RATE_HZ, pattern_instants
from pipeline.run.live.outputs.runner import LiveOutputs

HERE, THERE, VMC_PORT, OSC_PORT, QTM_PORT = "10.9.0.1", "10.9.0.2", 39539, 9000, 22222
TIME = b"/VMC/Ext/T\0\0,f\0\0"
BEFORE_S = 5.0


def link(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


def receive() -> None:
    """Join the network from the other side: receive OSC, and read a stream of Qualisys' protocol."""
    link("link", "set", "lo", "up")
    print("ready", flush=True)  # noqa: T201 - the capture waits for it
    sys.stdin.readline()
    link("addr", "add", f"{THERE}/24", "dev", "there")
    link("link", "set", "there", "up")
    receiver = socket.socket(type=socket.SOCK_DGRAM)
    receiver.bind((THERE, OSC_PORT))
    print("there", flush=True)  # noqa: T201 - likewise
    sys.stdin.readline()
    with socket.create_connection((HERE, QTM_PORT + 1), 30) as stream:
        for text in ("Version 1.22", "StreamFrames AllFrames 3D Skeleton"):
            stream.sendall(struct.pack("<II", 9 + len(text), 1) + text.encode() + b"\0")
        print("streams", flush=True)  # noqa: T201 - likewise
        while stream.recv(65_536):
            pass


def measure(lost_s: float) -> dict[str, Any]:
    """Delays of the capture, and of a receiver on this machine, with the network and without it."""
    command = [
        "unshare",
        "-n",
        sys.executable,
        "-P",
        "-m",
        "tests.pipeline.run.live.outputs.test_lost_network",
        "receive",
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:

        def step(expected: str, *words: str) -> None:
            assert other.stdout is not None
            assert other.stdin is not None
            assert other.stdout.readline() == f"{expected}\n"
            if words:
                link(*words)
            other.stdin.write("\n")
            other.stdin.flush()

        link("link", "set", "lo", "up")
        link("link", "add", "here", "type", "veth", "peer", "name", "there")
        step("ready", "link", "set", "there", "netns", str(other.pid))
        link("addr", "add", f"{HERE}/24", "dev", "here")
        link("link", "set", "here", "up")
        addresses = [f"vmc://127.0.0.1:{VMC_PORT}", f"osc://{THERE}:{OSC_PORT}", f"qtm://{HERE}:{QTM_PORT}"]
        with LiveOutputs(addresses, allow_network=True) as outputs:
            outputs.begin(LAYOUT.joints.names, RATE_HZ)
            step("there")
            result = _play(outputs, lost_s)
        other.kill()
    return result


def _play(outputs: LiveOutputs, lost_s: float) -> dict[str, Any]:
    arrivals: dict[float, float] = {}
    shown: dict[float, tuple[float, float]] = {}
    receiver = socket.socket(type=socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", VMC_PORT))
    receiver.settimeout(1.0)
    over = threading.Event()

    def take() -> None:
        while not over.is_set():
            try:
                packet = receiver.recv(65_535)
            except TimeoutError:
                continue
            arrivals[struct.unpack_from(">f", packet, packet.find(TIME) + len(TIME))[0]] = time.monotonic()

    thread = threading.Thread(target=take)
    thread.start()
    instant_at, start_s, number = pattern_instants(4), time.monotonic(), 0
    changes = [(BEFORE_S, "down"), (BEFORE_S + lost_s, "up")]
    states: dict[str, list[str]] = {}
    while (elapsed_s := time.monotonic() - start_s) < 2 * BEFORE_S + lost_s:
        if changes and elapsed_s > changes[0][0]:
            states[changes[0][1]] = [status.state for status in outputs.statuses]
            link("link", "set", "here", changes.pop(0)[1])
        instant, before_s = instant_at(number), time.monotonic()
        outputs.show(instant)
        after_s = time.monotonic()
        shown[float(np.float32(instant.time_s))] = after_s - before_s, after_s
        number = max(number + 1, int((time.monotonic() - start_s) * RATE_HZ))
        time.sleep(max(0.0, start_s + number / RATE_HZ - time.monotonic()))
    time.sleep(1.0)
    over.set()
    thread.join()
    receiver.close()
    states["end"] = [status.state for status in outputs.statuses]
    is_lost = np.array([BEFORE_S <= time_s < BEFORE_S + lost_s for time_s in shown])
    show_ms = 1e3 * np.array([took_s for took_s, _ in shown.values()])
    received_ms = 1e3 * np.array([arrivals.get(at, np.nan) - after_s for at, (_, after_s) in shown.items()])
    rows: dict[str, Any] = {"states": states, "dropped": [status.dropped for status in outputs.statuses]}
    for name, rows_of in (("with the network", ~is_lost), ("without it", is_lost)):
        rows[name] = {
            "instants": int(rows_of.sum()),
            "received": int(np.isfinite(received_ms[rows_of]).sum()),
            "show_p99_ms": float(np.percentile(show_ms[rows_of], 99)),
            "received_p50_ms": float(np.nanpercentile(received_ms[rows_of], 50)),
            "received_p99_ms": float(np.nanpercentile(received_ms[rows_of], 99)),
        }
    return rows


def in_own_network(lost_s: float) -> dict[str, Any]:
    """Result of ``measure`` in a process with a network of its own."""
    command = ["unshare", "-n", sys.executable, "-P", "-m", "tests.pipeline.run.live.outputs.test_lost_network"]
    done = subprocess.run([*command, "inside", str(lost_s)], check=True, stdout=subprocess.PIPE, text=True)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


@pytest.mark.slow
def test_lost_network_harms_no_other_output() -> None:
    if subprocess.run(["unshare", "-n", "ip", "link"], check=False, capture_output=True).returncode:
        pytest.skip("networks need root and the program ip")
    result = in_own_network(3.0)
    states = result["states"]
    assert states["up"][:2] == ["sending", "failed"]
    assert states["end"] == states["down"] == ["sending"] * 3
    lost = result["without it"]
    assert lost["received"] + result["dropped"][0] >= lost["instants"] > 0


if __name__ == "__main__":
    if sys.argv[1] == "receive":
        receive()
    elif sys.argv[1] == "inside":
        print(json.dumps(measure(float(sys.argv[2]))))  # noqa: T201
    else:
        print(json.dumps(in_own_network(float(sys.argv[1])), indent=1))  # noqa: T201
