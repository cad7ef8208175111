"""After a lost link, what has become of the result that the robot last acted on?  One pure function, one table.

The robot writes its last result and state into its own memory *before* the physical act, and goes on only when the
cell has answered.  So it is never behind the ledger, unless its memory was lost or restored; then a person has to look.
What a person has to look at is *unknown*: its slot is given to no other slab, and nothing is picked, until that person
has said where the slab is.
"""

from dataclasses import dataclass

from slabcell.catalogue import Fault
from slabcell.cell.records import OfferState
from slabcell_drivers.robot.protocol import AckState

__all__ = ["Decision", "given_up", "reconcile"]

_O, _A = OfferState, AckState


@dataclass(frozen=True, slots=True)
class Decision:
    """What the cell does: the result's new state, whether the robot shall go on and place it, and what to raise."""

    state: OfferState
    reason: str
    resume: bool = False
    fault: Fault | None = None


def reconcile(ledger: OfferState, robot: AckState, *, holds_part: bool) -> Decision:
    """Return the decision for a result that the ledger has as offered, accepted or grasped.

    ``robot`` is what the robot says of this result; NONE if it names another one or none.
    """
    if robot is _A.NONE:
        return _forgotten(ledger, holds_part=holds_part)
    if robot is _A.ACCEPTED and ledger is not _O.GRASPED:
        if holds_part:
            return Decision(_O.GRASPED, "the gripper holds it: it was grasped", resume=True)
        return Decision(_O.VOID, "not grasped; its place may be disturbed, so a new picture is needed")
    if robot is _A.GRASPED:
        if holds_part:
            return Decision(_O.GRASPED, "still in the gripper", resume=True)
        return Decision(_O.UNKNOWN, "lost after grasping", fault=Fault.PART_LOST)
    if robot is _A.PLACED:
        if holds_part:
            return Decision(_O.UNKNOWN, "reported placed, but the gripper holds a part", fault=Fault.PLACEMENT_UNKNOWN)
        return Decision(_O.PLACED, "placed while the link was lost")
    if robot in {_A.PICK_FAILED, _A.UNREACHABLE, _A.ABORTED}:
        return given_up(ledger, robot, holds_part=holds_part)
    return Decision(_O.UNKNOWN, f"the robot says {robot.name.lower()}, the ledger {ledger}", fault=_UNKNOWN)


_UNKNOWN = Fault.PLACEMENT_UNKNOWN


def given_up(ledger: OfferState, robot: AckState, *, holds_part: bool) -> Decision:
    """Return the decision for a result that the robot did not carry through."""
    why = {_A.PICK_FAILED: "pick failed", _A.UNREACHABLE: "unreachable for the robot"}.get(
        robot, "aborted by the robot"
    )
    if holds_part:
        return Decision(_O.FAILED, f"{why}; the gripper still holds a part", fault=Fault.GRIPPER_NOT_EMPTY)
    if ledger is _O.GRASPED:
        return Decision(_O.UNKNOWN, f"{why} after grasping", fault=Fault.PART_LOST)
    return Decision(_O.VOID if robot is _A.ABORTED else _O.FAILED, why)


def _forgotten(ledger: OfferState, *, holds_part: bool) -> Decision:
    """Decide about a result that the robot does not know of any more."""
    if ledger is _O.OFFERED:
        return Decision(_O.VOID, "offered, but the robot had not begun")
    if holds_part:
        reason = "the robot forgot the result that it holds in its gripper"
        return Decision(_O.FAILED, reason, fault=Fault.GRIPPER_NOT_EMPTY)
    if ledger is _O.ACCEPTED:
        return Decision(_O.VOID, "the robot forgot it before grasping")
    return Decision(_O.UNKNOWN, "grasped, then forgotten by the robot", fault=Fault.PLACEMENT_UNKNOWN)
