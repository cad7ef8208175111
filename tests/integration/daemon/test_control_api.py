"""The control API of a real daemon, through its real socket: what a client, a person and the HMI rely on."""

import json
import os
import select
import signal
import stat
import subprocess
import sys
import threading
import time
import uuid
from contextlib import suppress

import pytest

from slabcell.errors import SlabcellError, UnavailableError

pytestmark = [pytest.mark.integration, pytest.mark.timeout(180)]

LIMIT_S = 60.0


def wait_for(condition):
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline
        select.select([], [], [], 0.02)


def test_a_job_is_seen_from_its_first_event_to_its_last_slab(cell):
    heard = []

    def listen(client):
        with suppress(UnavailableError):
            heard.extend(client.events(stay=False))

    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        listener = threading.Thread(target=listen, args=(daemon.client,))
        before = daemon.client.get("/v1/status")
        assert (before["state"], before["opc40100"], before["job"], before["robot"]) == ("ready", "Ready", None, None)
        assert {link["name"]: link["state"] for link in before["links"]} == {
            "camera": "up",
            "robot": "connecting",
            "disk": "up",
        }
        listener.start()
        with cell.world.controller(daemon.address, seed=1) as controller:
            assert controller.run("SlabCell", max_wall_s=LIMIT_S).status == "done"
        after = daemon.client.get("/v1/status")
        assert after["job"]["state"] == "complete"
        assert after["job"]["slots"]["laid"] == [0, 1, 2, 3, 4]
        assert after["cycle"]["verification"]
        assert {"acquire", "measure", "total"} <= set(after["cycle"]["times_ms"])
        assert after["robot"]["request"] == "bye"
        job = daemon.client.get("/v1/jobs/current")
        assert {offer["state"] for offer in job["offers"]} == {"placed"}
        assert all(abs(item["dx_mm"]) < 0.5 for item in job["placements"])
        cycles = daemon.client.get("/v1/cycles")["cycles"]
        assert [cycle["verification"] for cycle in cycles] == [True, False]
        first = f"/v1/cycles/{cycles[1]['cycle']}"
        wait_for(lambda: daemon.client.get(first)["bundle"])
        telegrams = json.loads(daemon.client.fetch(f"{first}/files/telegrams.json").content)
        assert 'Type="2"' in telegrams[0]["telegram"]
        assert {item["direction"] for item in telegrams} == {"received", "sent"}
        assert telegrams[-1]["direction"] == "sent"
        assert daemon.client.fetch(f"{first}/files/frame.png").content.startswith(b"\x89PNG")
        shown = cell.slabcell("job", "show")
        assert "5 of 5 slots are laid" in shown.stdout, shown.stderr
        listed = json.loads(cell.slabcell("job", "list", "--json").stdout)
        assert [item["job"] for item in listed["jobs"]] == [1]
        listed = cell.slabcell("cycle", "list", "--job", "1")
        assert "measured, 5 of 5 lie" in listed.stdout, listed.stderr
        assert json.loads(cell.slabcell("cycle", "list", "--failed", "--json").stdout)["cycles"] == []
        assert "slot 0: pick" in cell.slabcell("cycle", "show", str(cycles[1]["cycle"])).stdout
        measured = cell.slabcell("cycle", "placements", "--slot", "3").stdout.splitlines()
        assert measured[0].startswith("at,job,slot,found,dx_mm")
        assert len(measured) == 2
        out = cell.folder / "saved"
        for words in (
            ("save", cycles[1]["cycle"], out / "frame.png", "--file", "frame.png"),
            ("picture", out / "now.png"),
            ("save", cycles[1]["cycle"], out / "cycle.zip"),
        ):
            saved = cell.slabcell("cycle", *map(str, words))
            assert saved.returncode == 0, saved.stderr
        assert (out / "frame.png").read_bytes().startswith(b"\x89PNG")
        assert (out / "now.png").read_bytes().startswith(b"\x89PNG")
        assert (out / "cycle.zip").read_bytes().startswith(b"PK")
        assert daemon.stop() == 0
        listener.join(LIMIT_S)
        assert not listener.is_alive()
    kinds = [event.kind for event in heard]
    assert {"link", "frame", "located", "stage", "job", "offer", "result", "verified", "cycle", "kept"} <= set(kinds)
    placed = [event.data["slot"] for event in heard if event.kind == "result" and event.data["state"] == "placed"]
    assert sorted(placed) == [0, 1, 2, 3, 4]
    numbers = [int(event.id.rpartition("-")[2]) for event in heard]
    assert numbers == sorted(set(numbers))


def test_a_person_halts_steps_and_goes_on_from_the_command_line(cell):
    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        assert cell.slabcell("cell", "stop").returncode == 0
        status = json.loads(cell.slabcell("status", "--json").stdout)
        assert (status["state"], status["packml"]) == ("halted", "Stopped")
        again = cell.slabcell("cell", "stop")
        assert again.returncode == 1
        assert "halt is refused in state halted" in again.stderr
        assert cell.slabcell("cell", "step").returncode == 0
        with cell.world.controller(daemon.address, seed=1) as controller:
            assert controller.run("SlabCell", max_wall_s=LIMIT_S).status == "halted"
        assert daemon.client.get("/v1/status")["state"] == "halted"
        assert len(daemon.client.get("/v1/jobs/current")["job"]["slots"]["laid"]) == 1
        assert cell.slabcell("cell", "start").returncode == 0
        with cell.world.controller(daemon.address, seed=1) as controller:
            assert controller.run("SlabCell", max_wall_s=LIMIT_S).status == "done"
        assert daemon.client.get("/v1/jobs/current")["job"]["slots"]["laid"] == [0, 1, 2, 3, 4]
        refused = cell.slabcell("job", "abandon")
        assert (refused.returncode, "no job is open" in refused.stderr) == (1, True), refused.stderr
        cell.world.strew(12)
        assert cell.slabcell("cell", "stop").returncode == cell.slabcell("cell", "step").returncode == 0
        with cell.world.controller(daemon.address, seed=1) as controller:
            assert controller.run("SlabCell", max_wall_s=LIMIT_S).status == "halted"
        assert "job 2 is abandoned" in cell.slabcell("job", "abandon").stdout
        assert daemon.client.get("/v1/jobs/2")["job"]["state"] == "abandoned"


def test_a_lost_camera_is_an_alarm_that_a_person_sees_and_that_goes_when_it_is_back(cell):
    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        last = daemon.client.get("/v1/status")["event"]
        events = daemon.client.events(kinds=["alarm"], after=last)
        cell.camera.faults.apply("freeze on")
        came = next(events)
        assert (came.data["number"], came.data["change"]) == (1101, "came")
        shown = cell.slabcell("alarms", "list")
        assert "1101 Camera lost (high)" in shown.stdout
        said = cell.slabcell("alarms", "acknowledge", "1101")
        assert "it stands on until its cause is gone" in said.stdout
        assert next(events).data["change"] == "changed"
        cell.camera.faults.apply("freeze off")
        went = next(events)
        assert (went.data["number"], went.data["change"]) == (1101, "went")
        events.close()
        past = daemon.client.get("/v1/alarms/history")["alarms"][0]
        assert (past["number"], past["why"]) == (1101, "its cause is gone")


def test_a_write_is_done_once_whatever_becomes_of_the_daemon(cell):
    key = str(uuid.uuid4())
    with cell.daemon() as daemon:
        done = daemon.client.post("/v1/stop", key=key)
        assert daemon.client.post("/v1/stop", key=key) == done
        with pytest.raises(SlabcellError, match="used for another request"):
            daemon.client.post("/v1/start", key=key)
        daemon.process.send_signal(signal.SIGKILL)
        daemon.process.wait(LIMIT_S)
    with cell.daemon() as daemon:
        assert daemon.client.post("/v1/stop", key=key) == done
        assert daemon.client.get("/v1/status")["state"] == "ready"


def test_the_socket_is_for_its_group_and_is_gone_in_the_end(cell):
    with cell.daemon() as daemon:
        mode = cell.socket.stat().st_mode
        assert stat.S_ISSOCK(mode)
        assert stat.S_IMODE(mode) == 0o660
        answered = subprocess.run(
            ["curl", "-s", "--unix-socket", str(cell.socket), "http://localhost/v1/status"],
            capture_output=True,
            check=True,
            timeout=LIMIT_S,
        )
        assert json.loads(answered.stdout)["pid"] == daemon.process.pid
        assert daemon.stop() == 0
    assert not cell.socket.exists()
    gone = cell.slabcell("status")
    assert gone.returncode == 69
    assert "no daemon answers at" in gone.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_who_is_not_in_the_group_is_told_so(cell):
    code = (
        "import os, sys; from pathlib import Path; from slabcell.service.api.client import ApiClient;"
        " os.setgroups([]); os.setgid(65534); os.setuid(65534); ApiClient(Path(sys.argv[1])).get('/v1/status')"
    )
    with cell.daemon():
        refused = subprocess.run(
            [sys.executable, "-c", code, str(cell.socket)], capture_output=True, text=True, check=False
        )
    assert "you may not use this socket" in refused.stderr
