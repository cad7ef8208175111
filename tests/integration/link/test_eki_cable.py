"""A cable that is really pulled: two network namespaces, one wire between them, and the kernel's own timers.

Needs root and iproute2; run with ``-m slow``.  Prints how long the loss took to be noticed.
"""

import os
import shutil
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.integration, pytest.mark.slow]

CELL = """
import asyncio, subprocess, time
from slabcell_drivers.robot.eki import EkiServer
from slabcell_drivers.robot.protocol import Answer, LinkState

async def main():
    states = asyncio.Queue()
    link = EkiServer("10.99.0.1", 54610, on_state=states.put_nowait)
    async def handler(request):
        return Answer(1, 1, request.sequence)
    await link.start(handler)
    while await states.get() is not LinkState.CONNECTED:
        pass
    subprocess.run(["ip", "link", "set", "cellside", "down"], check=True)
    began = time.monotonic()
    assert await asyncio.wait_for(states.get(), 60) is LinkState.LISTENING
    print(f"noticed: {link.last_end.value} after {time.monotonic() - began:.2f} s")
    await link.stop()

asyncio.run(main())
"""
ROBOT = """
import socket, time
deadline = time.monotonic() + 30
while True:
    try:
        connection = socket.create_connection(("10.99.0.1", 54610), 1)
        break
    except OSError:
        if time.monotonic() > deadline:
            raise
        time.sleep(0.05)
connection.settimeout(None)
connection.recv(1)
"""
WIRE = """
set -eu
ip link set lo up
ip link add cellside type veth peer name robotside
unshare -n sh -c 'echo ready; exec sleep 120' > "$1/ready" &
robot=$!
until grep -q ready "$1/ready"; do :; done
ip link set robotside netns "$robot"
ip addr add 10.99.0.1/24 dev cellside
ip link set cellside up
nsenter -t "$robot" -n sh -c 'ip addr add 10.99.0.2/24 dev robotside; ip link set robotside up'
nsenter -t "$robot" -n "$PYTHON" -c "$ROBOT" &
talker=$!
status=0
"$PYTHON" -c "$CELL" || status=$?
kill "$talker" "$robot" || true
exit "$status"
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root for a network namespace")
@pytest.mark.skipif(not all(map(shutil.which, ("ip", "unshare", "nsenter"))), reason="needs iproute2 and util-linux")
def test_a_pulled_cable_is_noticed_without_a_word_from_the_robot(tmp_path):
    environment = {**os.environ, "PYTHON": sys.executable, "CELL": CELL, "ROBOT": ROBOT}
    command = ["unshare", "-n", "sh", "-c", WIRE, "wire", str(tmp_path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    assert "noticed: the robot no longer answers" in done.stdout
