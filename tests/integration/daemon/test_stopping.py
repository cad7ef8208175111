"""SIGTERM: is what was offered taken back, and everything closed in time, whatever hangs just then?"""

import contextlib
import socket
import sqlite3

import pytest

from slabcell_drivers.robot.eki.codec import decode_answer, encode_request
from slabcell_drivers.robot.protocol import Answer, Request, RequestType

pytestmark = [pytest.mark.integration, pytest.mark.timeout(180)]

LIMIT_S = 60.0


class Robot:
    """Says what it is told to, over EKI."""

    def __init__(self, address):
        self.socket = socket.create_connection(address, LIMIT_S)
        self.session = self.sequence = 0

    def say(self, kind: RequestType) -> None:
        self.sequence += 1
        self.socket.sendall(encode_request(Request(kind, self.session, self.sequence)))

    def ask(self, kind: RequestType) -> Answer:
        self.say(kind)
        heard = b""
        while not heard.endswith(b"</Vis>"):
            heard += self.socket.recv(4096) or pytest.fail(f"the link ended after {heard!r}")
        answer = decode_answer(heard)
        self.session = answer.session
        return answer


@contextlib.contextmanager
def greeted(address):
    robot = Robot(address)
    with robot.socket:
        robot.ask(RequestType.HELLO)
        yield robot


def states(cell):
    with contextlib.closing(sqlite3.connect(cell.folder / "state" / "ledger.sqlite")) as book:
        return [state for (state,) in book.execute("SELECT state FROM offers ORDER BY result_id")]


def test_what_was_offered_is_taken_back_when_the_cell_ends(cell):
    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        with greeted(daemon.address) as robot:
            assert robot.ask(RequestType.TRIGGER).left > 0
            assert robot.ask(RequestType.NEXT).offer is not None
            assert states(cell)[0] == "offered"
            assert daemon.stop() == 0
    assert set(states(cell)) == {"void"}
    assert not cell.socket.exists()
    assert "Traceback" not in (cell.folder / "daemon.log").read_text()


def test_a_cell_ends_in_time_although_its_camera_does_not_answer_yet(cell):
    cell.edit("timeout_s = 20.0", "timeout_s = 60.0")
    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        with greeted(daemon.address) as robot:
            cell.camera.faults.apply("late 50")
            robot.say(RequestType.TRIGGER)
            cell.wait_for_log("acquiring")
            assert daemon.stop() == 0  # though its driver is still in the picture, which may take a minute
    log = (cell.folder / "daemon.log").read_text()
    assert "the robot's request did not end in time" in log
    assert "the camera could not be given back in time" in log
    assert states(cell) == []
