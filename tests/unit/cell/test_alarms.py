"""Do alarms come once, stay as long as they must, and go once?"""

import pytest

from slabcell.catalogue import Fault
from slabcell.cell.alarms import MAX_SHELVED_S, Alarms
from slabcell.cell.events import AlarmCame, AlarmChanged, AlarmWent
from slabcell.errors import UsageError

pytestmark = pytest.mark.unit


class Clock:
    now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def told():
    return []


@pytest.fixture
def alarms(clock, told):
    return Alarms(told.append, clock=clock)


def test_an_alarm_is_told_once_when_it_comes_and_once_when_it_goes(alarms, told):
    for _ in range(3):
        alarms.come(Fault.CAMERA_LOST, "gone")
    for _ in range(3):
        alarms.cease(Fault.CAMERA_LOST)
    assert told == [AlarmCame(Fault.CAMERA_LOST, "gone"), AlarmWent(Fault.CAMERA_LOST, "its cause is gone")]
    assert alarms.counts[Fault.CAMERA_LOST] == 1


def test_a_latched_alarm_waits_for_a_person_when_its_cause_is_gone(alarms):
    alarms.come(Fault.DISK_FULL, "no room")
    alarms.cease(Fault.DISK_FULL)
    (standing,) = alarms.standing
    assert standing.cause_gone
    alarms.come(Fault.DISK_FULL, "again")
    assert not alarms.standing[0].cause_gone
    assert alarms.acknowledge(Fault.DISK_FULL)
    assert not alarms.acknowledge(Fault.DISK_FULL)
    assert alarms.standing == ()


def test_an_acknowledged_alarm_stands_on_as_long_as_its_cause(alarms, told):
    alarms.come(Fault.CAMERA_LOST, "gone")
    assert alarms.acknowledge(Fault.CAMERA_LOST, "alice")
    assert alarms.acknowledge(Fault.CAMERA_LOST, "bob")
    assert alarms.standing[0].acknowledged_by == "alice"
    assert told[1:] == [AlarmChanged(Fault.CAMERA_LOST)]
    alarms.cease(Fault.CAMERA_LOST)
    assert alarms.standing == ()


def test_an_alarm_that_needs_a_restart_is_not_acknowledged_away(alarms):
    alarms.come(Fault.CALIBRATION_MISMATCH, "another camera")
    alarms.acknowledge(Fault.CALIBRATION_MISMATCH, "alice")
    assert alarms.has(Fault.CALIBRATION_MISMATCH)


def test_an_unshelved_alarm_is_seen_again(alarms):
    alarms.come(Fault.CAMERA_LOST, "gone")
    alarms.shelve(Fault.CAMERA_LOST, 60.0)
    alarms.unshelve(Fault.CAMERA_LOST)
    assert [alarm.fault for alarm in alarms.shown] == [Fault.CAMERA_LOST]


def test_the_most_urgent_is_shown_first_and_the_newest_among_equals(alarms, clock):
    for fault in (Fault.BUNDLE_UNWRITABLE, Fault.NO_MATCH, Fault.CAMERA_LOST, Fault.DISK_FULL):
        clock.now_s += 1
        alarms.come(fault, "")
    shown = [alarm.fault for alarm in alarms.shown]
    assert shown == [Fault.DISK_FULL, Fault.CAMERA_LOST, Fault.NO_MATCH, Fault.BUNDLE_UNWRITABLE]


def test_a_shelved_alarm_stands_unseen_until_its_time_is_over(alarms, clock):
    alarms.come(Fault.CAMERA_LOST, "gone")
    alarms.shelve(Fault.CAMERA_LOST, 60.0)
    assert alarms.shown == ()
    assert alarms.has(Fault.CAMERA_LOST)
    clock.now_s += 60.0
    assert [alarm.fault for alarm in alarms.shown] == [Fault.CAMERA_LOST]


def test_an_alarm_whose_time_on_the_shelf_is_over_is_told_of_once(alarms, clock, told):
    for fault, duration_s in ((Fault.CAMERA_LOST, 60.0), (Fault.DISK_FULL, 90.0)):
        alarms.come(fault, "gone")
        alarms.shelve(fault, duration_s)
    told.clear()
    alarms.show_due()
    assert told == []
    clock.now_s += 60.0
    for _ in range(3):
        alarms.show_due()
    assert told == [AlarmChanged(Fault.CAMERA_LOST)]


@pytest.mark.parametrize("duration_s", [0.0, -1.0, MAX_SHELVED_S + 1, float("nan")])
def test_nothing_is_shelved_for_good(alarms, duration_s):
    alarms.come(Fault.CAMERA_LOST, "gone")
    with pytest.raises(UsageError, match="cannot be shelved"):
        alarms.shelve(Fault.CAMERA_LOST, duration_s)


def test_what_does_not_stand_cannot_be_shelved(alarms):
    with pytest.raises(UsageError, match="does not stand"):
        alarms.shelve(Fault.CAMERA_LOST, 60.0)
