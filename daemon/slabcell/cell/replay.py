"""Does a recorded cycle give the same poses today?  Runs vision and planning on a bundle and compares pair by pair."""

from dataclasses import dataclass

from slabcell.cell.bundle_file import Bundle, BundleError
from slabcell.cell.planning import Planner
from slabcell.cell.records import Pair
from slabcell.geometry import normalize_deg
from slabcell.recipe import Recipe
from slabcell.vision.layers import LayeredLocator

__all__ = ["Difference", "NothingToReplayError", "Replay", "replay"]


class NothingToReplayError(BundleError):
    """The bundle is sound, but no pose was offered from its picture."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One slot that came out otherwise; distances are between recorded and new poses, None where one is missing."""

    slot: int
    what: str
    pick_mm: float | None = None
    place_mm: float | None = None
    turn_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Replay:
    """What came out again, and what came out otherwise."""

    recorded: tuple[Pair, ...]
    pairs: tuple[Pair, ...]
    differences: tuple[Difference, ...]
    same_order: bool

    @property
    def same(self) -> bool:
        """Whether every pose is the same to the last digit that was written, and in the same order."""
        return not self.differences and self.same_order


def replay(bundle: Bundle, recipe: Recipe | None = None) -> Replay:
    """Return what vision and planning make of the recorded picture, with another recipe if one is given.

    Raises NothingToReplayError if the bundle holds no picture to run again, and what the vision raises.
    """
    if bundle.verification or bundle.picture is None:
        what = "a verification, in which nothing was offered" if bundle.verification else "a cycle without a picture"
        raise NothingToReplayError(f"{bundle.path}: is {what}; give a bundle of a cycle")
    used = recipe or bundle.recipe
    located = LayeredLocator(bundle.calibration, used).locate(
        bundle.picture, area_mm=bundle.settings.pick_area, free_slots=bundle.free_slots
    )
    planned = Planner(used, bundle.settings, bundle.arm).plan(
        located.parts, laid=bundle.laid_slots, correction_mm=bundle.correction_mm
    )
    before = {pair.slot: pair for pair in bundle.pairs}
    after = {pair.slot: pair for pair in planned.pairs}
    differences: list[Difference] = []
    for slot in sorted(before.keys() | after.keys()):
        if slot not in after:
            refused = next((item.detail for item in planned.refused if item.slot == slot), "no part was matched")
            differences.append(Difference(slot, f"was offered, is not now: {refused}"))
        elif slot not in before:
            differences.append(Difference(slot, "was not offered, is now"))
        elif before[slot] != after[slot]:
            differences.append(_difference(before[slot], after[slot]))
    order, now = ([slot for slot in side if slot in before.keys() & after.keys()] for side in (before, after))
    return Replay(bundle.pairs, planned.pairs, tuple(differences), order == now)


def _difference(old: Pair, new: Pair) -> Difference:
    turn_old, turn_new = (pair.place.a_deg - pair.pick.a_deg for pair in (old, new))
    return Difference(
        old.slot,
        "other poses",
        pick_mm=((old.pick.x_mm - new.pick.x_mm) ** 2 + (old.pick.y_mm - new.pick.y_mm) ** 2) ** 0.5,
        place_mm=((old.place.x_mm - new.place.x_mm) ** 2 + (old.place.y_mm - new.place.y_mm) ** 2) ** 0.5,
        turn_deg=abs(normalize_deg(turn_new - turn_old)),
    )
