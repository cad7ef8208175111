"""How right and how exact is the vision?  Locates rendered scenes whose truth is known, with fresh seeds in each run.

    python benchmarks/vision_accuracy.py [--scenes N] [--seed S] [--pool mixed|irregular] [CONDITION ...]

For each condition: slabs matched right, wrong (another slot, or turned by more than 5°) and missed; unknown slabs that
were accepted; distance from the truth of the slab's middle in pixels, and of the angle in degrees (median / 95th
percentile / greatest); and error over stated sigma (RMS; 1 is true).  Exit code 1 if a slab was matched wrong or an
unknown one accepted.
"""

import argparse
import secrets
import sys
from dataclasses import dataclass, field

import cv2
import numpy as np
import shapely

from scenes import CONDITIONS, BenchmarkScene, TrueSlab, make_scene
from slabcell.vision import Locator
from slabcell.vision.result import LocatedPart

WRONG_DEG = 5.0


@dataclass
class Tally:
    """What was found on the scenes of one condition."""

    right: int = 0
    wrong: int = 0
    missed: int = 0
    unknown: int = 0
    accepted: int = 0
    position_px: list[float] = field(default_factory=list)
    angle_deg: list[float] = field(default_factory=list)
    ratios: list[tuple[float, float, float]] = field(default_factory=list)
    kerf_mm: list[float] = field(default_factory=list)
    times_ms: list[float] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def main() -> int:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("conditions", nargs="*", default=["clean", "typical", "harsh", "thick"])
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--pool", default="mixed", choices=["mixed", "irregular"])
    parser.add_argument("--unknowns", type=int, default=1)
    parser.add_argument("--notes", action="store_true", help="say what went wrong where")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    first = secrets.randbelow(10**6) if options.seed is None else options.seed
    print(f"seeds {first} ... {first + options.scenes - 1}, pool {options.pool}")
    print(
        f"{'condition':10} {'right':>11} {'wrong':>5} {'missed':>6} {'unknown in':>10}  {'position px':>22}"
        f"  {'angle deg':>22}  {'err/sigma x y a':>16}  {'ms':>6}  {'kerf mm':>7}"
    )
    bad = False
    for condition in options.conditions or CONDITIONS:
        tally = Tally()
        for seed in range(first, first + options.scenes):
            judge(make_scene(condition, seed, pool=options.pool, unknowns=options.unknowns), tally)
        report(condition, tally)
        bad |= tally.wrong > 0 or tally.accepted > 0
        if options.notes:
            print("\n".join(f"  {note}" for note in tally.notes))
    return 1 if bad else 0


def judge(scene: BenchmarkScene, tally: Tally) -> None:
    """Locate one scene and add what was found to the tally."""
    locator = Locator(scene.calibration, scene.recipe)
    locator.locate(scene.image)
    result = locator.locate(scene.image)
    tally.times_ms.append(result.timing_ms["total"])
    left = list(result.parts)
    for slab in scene.slabs:
        found = next((part for part in left if covers(slab, part)), None)
        if found is not None:
            left.remove(found)
        if slab.slot is None:
            tally.unknown += 1
            tally.accepted += found is not None
            if found is not None:
                tally.notes.append(f"{scene.name}: {slab.kind} accepted as slot {found.slot}")
        elif found is None:
            tally.missed += 1
            refused = [
                blob.detail
                for blob in result.rejected
                if np.hypot(*(scene.calibration.image_from_table(slab.outline).mean(axis=0) - (blob.u, blob.v))) < 60
            ]
            tally.notes.append(f"{scene.name}: slot {slab.slot} missed {refused} [{result.segmentation}]")
        else:
            compare(scene, slab, found, tally)


def covers(slab: TrueSlab, part: LocatedPart) -> bool:
    """Return whether the pick point lies on the slab."""
    return bool(shapely.Polygon(slab.outline).contains(shapely.Point(part.pick.x_mm, part.pick.y_mm)))


def compare(scene: BenchmarkScene, slab: TrueSlab, part: LocatedPart, tally: Tally) -> None:
    """Add one located slab to the tally."""
    assert slab.slot is not None
    assert slab.table_from_assembly is not None
    found = part.table_to_assembly.inverse()
    step = 360.0 / slab.symmetry_order
    turns = (found.rotation_deg - slab.table_from_assembly.rotation_deg) / step
    angle = (turns - round(turns)) * step
    if part.slot != slab.slot or abs(angle) > WRONG_DEG:
        tally.wrong += 1
        tally.notes.append(f"{scene.name}: slot {slab.slot} taken for {part.slot}, {angle:.1f} deg off")
        return
    tally.right += 1
    middle = scene.recipe.template.slots[slab.slot].centroid
    error = found.apply(middle) - slab.table_from_assembly.apply(middle)
    tally.position_px.append(float(np.hypot(*error)) / scene.mm_per_px)
    tally.angle_deg.append(abs(angle))
    tally.kerf_mm.append(getattr(part, "kerf_mm", float("nan")))
    tally.ratios.append(
        (float(error[0]) / part.sigma.x_mm, float(error[1]) / part.sigma.y_mm, angle / part.sigma.a_deg)
    )
    if np.hypot(*error) / scene.mm_per_px > 0.1:
        tally.notes.append(f"{scene.name}: slot {slab.slot} {np.hypot(*error) / scene.mm_per_px:.3f} px off")


def report(condition: str, tally: Tally) -> None:
    """Print one line."""
    known = tally.right + tally.wrong + tally.missed

    def three(values: list[float]) -> str:
        return "/".join(f"{value:.4f}" for value in np.percentile(values, [50, 95, 100])) if values else "-"

    ratios = " ".join(f"{value:.2f}" for value in np.sqrt(np.mean(np.square(tally.ratios), axis=0)))
    print(
        f"{condition:10} {f'{tally.right}/{known}':>11} {tally.wrong:5} {tally.missed:6}"
        f" {f'{tally.accepted}/{tally.unknown}':>10}  {three(tally.position_px):>22}  {three(tally.angle_deg):>22}"
        f"  {ratios:>16}  {np.median(tally.times_ms):6.1f}  {np.median(tally.kerf_mm):7.3f}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
