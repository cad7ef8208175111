"""Camera and robot are gone when the cell starts, and the network too: does it start, say so, and find them later?"""

import json
import socket

import pytest

pytestmark = [pytest.mark.faults, pytest.mark.timeout(180)]

LIMIT_S = 60.0


def test_without_camera_and_robot_the_daemon_is_ready_says_what_is_missing_and_finds_both_later(cell):
    cell.camera.faults.apply("freeze on")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        supervisor.bind(str(cell.folder / "notify"))
        supervisor.settimeout(LIMIT_S)
        with cell.daemon(NOTIFY_SOCKET=str(cell.folder / "notify")) as daemon:
            assert supervisor.recv(4096).startswith(b"READY=1")
            cell.wait_for_log("camera not open")
            status = json.loads(cell.slabcell("status", "--json").stdout)
            links = {link["name"]: link["state"] for link in status["links"]}
            assert (links["camera"], links["robot"]) == ("down", "connecting")
            assert "1101 Camera lost" in cell.slabcell("alarms", "list").stdout
            cell.camera.faults.apply("freeze off")
            cell.wait_for_log("camera open")
            with cell.world.controller(daemon.address, seed=1) as controller:
                result = controller.run("SlabCell", max_wall_s=LIMIT_S)
            assert (result.status, result.message) == ("done", "")
            assert daemon.stop() == 0
