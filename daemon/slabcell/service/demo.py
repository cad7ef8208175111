"""What happens in a demo?  A cell is built, calibrated and run until its job ends; then the truth is measured.

Every part is the one that a real cell runs, but for the world itself: camera, arm and gripper belong to it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Protocol

import cv2

from slabcell import __version__
from slabcell.calibration import Calibration, save_calibration
from slabcell.cell import events
from slabcell.cell.cell import Cell
from slabcell.cell.records import OfferState
from slabcell.errors import ConfigurationError, SlabcellError, UsageError
from slabcell.recipe import Recipe, load_recipe
from slabcell.service.builder import CellParts, cell_settings, open_cell
from slabcell.service.config import CellConfig, FrameConfig
from slabcell.service.config_layers import load_config
from slabcell.service.demo_camera import DemoCamera, demo_camera
from slabcell.service.demo_robot import DemoLink, demo_robot
from slabcell.service.simulated import BoardPoses, SimulatedCell, calibrate_from_boards
from slabcell.vision.overlay import draw_overlay
from slabcell.vision.result import LocateResult
from slabcell_drivers.camera import ImageFrame, Pixels
from slabcell_drivers.krc import RunResult
from slabcell_drivers.robot.arm import ArmModel, arm_by_name
from slabcell_drivers.simulation import Placement, Scene, SceneError, load_scene

__all__ = ["DemoOptions", "DemoParts", "Progress", "demo_folder", "read_demo_parts", "run_demo", "scene_names"]

LIMIT_MM = 0.5
LIMIT_DEG = 0.5

Document = dict[str, Any]


class Progress(Protocol):
    """Is told how far the demo is."""

    def stage(self, name: str, total: int | None = None) -> None:
        """Begin a stage; ``total`` is what there is to count in it."""
        ...

    def advance(self, text: str) -> None:
        """Count one thing of the stage."""
        ...


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What to show: a shipped scene's name or a scene file, how the slabs are strewn, where files go; camera, link."""

    scene: str
    seed: int
    out: Path
    camera: DemoCamera = DemoCamera.SIMULATED
    link: DemoLink = DemoLink.EKI


@dataclass(frozen=True, slots=True)
class DemoParts:
    """What a demo is made of, read and checked."""

    config: CellConfig
    scene: Scene
    recipe: Recipe
    arm: ArmModel


def scene_names() -> list[str]:
    """Return the names of the shipped scenes."""
    folder = files("slabcell") / "data" / "config" / "scenes"
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


async def run_demo(options: DemoOptions, progress: Progress) -> Document:
    """Run the demo and return the ``slabcell.demo/1`` document; pictures and bundles are left in the folder.

    Raises SlabcellError.
    """
    parts = read_demo_parts(options.scene)
    out = demo_folder(options.out)
    simulated = SimulatedCell(parts.scene, options.seed, parts.arm, parts.config.robot.tool.to_frame())

    boards = BoardPoses.of(parts.scene, options.seed)
    progress.stage("calibrating from pictures of a board", len(boards))
    calibration, lens, plane = await asyncio.to_thread(
        calibrate_from_boards, parts.scene, boards, options.seed, progress.advance
    )
    save_calibration(out / "calibration.json", calibration)

    progress.stage("taking the first picture")
    before = await asyncio.to_thread(simulated.picture, 0)
    cell_run = _Run(parts, simulated, options, calibration, progress)
    await cell_run.run(out, seed=options.seed)

    progress.stage("measuring what was laid")
    after = await asyncio.to_thread(simulated.picture, 1_000_000)
    placements = simulated.world.placements([slot.vertices for slot in parts.recipe.template.slots])
    document = _document(options, parts, placements, cell_run)
    document["calibration"] = {"rms_px": lens.rms_px, "plane_rms_px": plane.rms_px, "views": len(boards)}
    document["files"] = await asyncio.to_thread(_write_files, out, document, before, after, cell_run)
    return document


class _Run:
    """One job: the cell behind its link, and the robot that runs its program against it."""

    def __init__(
        self,
        parts: DemoParts,
        simulated: SimulatedCell,
        options: DemoOptions,
        calibration: Calibration,
        progress: Progress,
    ) -> None:
        self._parts = parts
        self._simulated = simulated
        self._camera, self._link = options.camera, options.link
        self._calibration = calibration
        self._progress = progress
        self._frame: ImageFrame | None = None
        self.seen: tuple[ImageFrame, LocateResult] | None = None
        """The first picture, and what the vision found in it."""
        self.cycles: list[events.CycleRecord] = []
        self.scores: dict[int, float] = {}
        self.result: RunResult | None = None
        self.messages: tuple[str, ...] = ()
        self.program = ""

    async def run(self, out: Path, *, seed: int) -> None:
        """Run the job to its end."""
        parts = self._parts
        async with self._cell(out) as cell:
            unsubscribe = cell.subscribe(self._see)
            robot_at = demo_robot(self._link, self._simulated, parts.config, parts.arm, cell.handle, seed)
            try:
                async with robot_at as robot:
                    self._progress.stage("laying the slabs", len(parts.recipe.template.slots))
                    self.program = robot.program
                    try:
                        self.result = await robot.run()
                    finally:
                        self.messages = robot.messages
            finally:
                unsubscribe()

    @contextlib.asynccontextmanager
    async def _cell(self, out: Path) -> AsyncGenerator[Cell]:
        parts = CellParts(self._calibration, self._parts.recipe, self._parts.arm, cell_settings(self._parts.config))
        async with demo_camera(self._camera, self._simulated) as camera, open_cell(parts, camera, out) as (cell, _):
            yield cell

    def _see(self, event: events.Event) -> None:
        match event:
            case events.ResultMoved(offer) if offer.state is OfferState.PLACED:
                self.scores[offer.slot] = offer.score
                self._progress.advance(f"slot {offer.slot} filled")
            case events.FrameTaken(frame):
                self._frame = frame
            case events.PartsLocated(result) if self.seen is None and self._frame is not None:
                self.seen = self._frame, result
            case events.CycleEnded(cycle):
                self.cycles.append(cycle)
            case _:
                pass


def read_demo_parts(name: str) -> DemoParts:
    """Return what the demo of a scene is made of: a shipped scene by its name, or a file beside its recipe."""
    with as_file(files("slabcell") / "data" / "config") as folder:
        config = load_config(folder / "demo.toml")
        if name in scene_names():
            scene_file, recipe_file = folder / "scenes" / f"{name}.toml", folder / "recipes" / f"{name}.toml"
        elif name.endswith(".toml"):
            scene_file = Path(name)
            recipe_file = scene_file.with_name(f"{scene_file.stem}-recipe.toml")
        else:
            msg = f"there is no scene {name!r}; choose {', '.join(scene_names())}, or name a .toml file of your own"
            raise UsageError(msg)
        try:
            scene = load_scene(scene_file)
        except SceneError as error:
            raise ConfigurationError(str(error)) from error
        recipe = load_recipe(recipe_file)
    return DemoParts(_as_built(config, scene, recipe_file), scene, recipe, arm_by_name(config.robot.model))


def _as_built(config: CellConfig, scene: Scene, recipe: Path) -> CellConfig:
    """Return the configuration with both bases where the scene has them: as an integrator teaches them."""
    bases = {
        "pick_base": FrameConfig.from_frame(scene.table.frame),
        "place_base": FrameConfig.from_frame(scene.assembly.frame),
    }
    limits = {"tolerance_mm": LIMIT_MM, "tolerance_deg": LIMIT_DEG}
    return config.model_copy(
        update={
            "recipe": recipe,
            "robot": config.robot.model_copy(update=bases),
            "table": config.table.model_copy(update={"pick_area": list(scene.table.pick_area)}),
            "verification": config.verification.model_copy(update=limits),
        }
    )


def demo_folder(out: Path) -> Path:
    """Return the folder of a demo, made if need be, without the ledger of an earlier one.  Raises SlabcellError."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for stale in [*out.glob("ledger.sqlite*"), *out.glob("history.sqlite*"), *out.glob("active-*.json")]:
            stale.unlink()  # a demo is a new cell each time; an earlier one's ledger is not its history
    except OSError as error:
        msg = f"{out}: cannot be made a folder of the demo: {error.strerror}; choose another with --out"
        raise SlabcellError(msg) from error
    return out.resolve()


def _document(options: DemoOptions, parts: DemoParts, placements: tuple[Placement, ...], run: _Run) -> Document:
    failures = [text for placement in placements if (text := _failure(placement))]
    result = run.result
    if result is None or result.status != "done":
        failures.insert(
            0, f"the robot program ended as {result.status}: {result.message}" if result else "no program ran"
        )
    filled = [placement for placement in placements if placement.filled]
    stages: dict[str, None] = {}
    for cycle in run.cycles:
        stages.update(dict.fromkeys(stage for stage in cycle.times_ms if stage != "total"))
    return {
        "schema": "slabcell.demo/1",
        "version": __version__,
        "scene": parts.scene.name,
        "seed": options.seed,
        "camera": options.camera.value,
        "link": options.link.value,
        "ok": not failures,
        "failures": failures,
        "limits": {"position_mm": LIMIT_MM, "angle_deg": LIMIT_DEG},
        "worst": {
            "position_mm": max((math.hypot(p.dx_mm, p.dy_mm) for p in filled), default=None),
            "angle_deg": max((abs(p.dtheta_deg) for p in filled), default=None),
        },
        "slots": [
            {
                "slot": p.slot,
                "filled": p.filled,
                "score": run.scores.get(p.slot),
                "dx_mm": p.dx_mm if p.filled else None,
                "dy_mm": p.dy_mm if p.filled else None,
                "dtheta_deg": p.dtheta_deg if p.filled else None,
            }
            for p in placements
        ],
        "stages": [*stages, "total"],
        "cycles": [
            {"cycle": number, "timing_ms": {stage: round(ms, 3) for stage, ms in cycle.times_ms.items()}}
            for number, cycle in enumerate(run.cycles, start=1)
        ],
        "robot": {
            "program": run.program,
            "status": result.status if result else "",
            "virtual_time_s": result.virtual_time_s if result else 0.0,
            "statements": result.statements if result else 0,
            "messages": list(run.messages),
        },
    }


def _failure(placement: Placement) -> str:
    if not placement.filled:
        return f"slot {placement.slot} is not filled"
    off_mm, off_deg = math.hypot(placement.dx_mm, placement.dy_mm), abs(placement.dtheta_deg)
    if off_mm > LIMIT_MM or off_deg > LIMIT_DEG:
        return (
            f"slot {placement.slot}: the slab lies {off_mm:.3f} mm and {off_deg:.3f}° off;"
            f" the limits are {LIMIT_MM} mm and {LIMIT_DEG}°"
        )
    return ""


def _write_files(out: Path, document: Document, before: Pixels, after: Pixels, run: _Run) -> dict[str, str]:
    """Write the pictures and the document; return the paths by what they are."""
    pictures: dict[str, Pixels] = {"before": before, "after": after}
    if run.seen is not None:
        frame, result = run.seen
        pictures["overlay"] = draw_overlay(frame.pixels, result)
    paths = {"folder": str(out), "bundles": str(out / "bundles"), "calibration": str(out / "calibration.json")}
    for name, picture in pictures.items():
        path = out / f"{name}.png"
        path.write_bytes(_encode(picture))
        paths[name] = str(path)
    (out / "demo.json").write_text(json.dumps({**document, "files": paths}, indent=1) + "\n", encoding="utf-8")
    return paths


def _encode(picture: Pixels) -> bytes:
    done, encoded = cv2.imencode(".png", picture)
    if not done:
        msg = f"a picture of {picture.shape[1]}x{picture.shape[0]} pixels could not be encoded as PNG"
        raise SlabcellError(msg)
    return encoded.tobytes()
