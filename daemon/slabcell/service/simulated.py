"""How does a whole cell come to life without hardware?  World, camera and software KRC, wired as a real cell is.

The world is the truth: slabs move in it only when the gripper carries them.  The camera renders it, the software KRC
moves its tool, and two wires join robot and gripper: an output that grips and an input that feels a part.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable

from slabcell.calibration import (
    Board,
    Calibration,
    CameraResult,
    PlaneResult,
    calibrate_camera,
    calibrate_plane,
    detect_boards,
)
from slabcell.errors import CalibrationError
from slabcell_drivers.camera import CameraInfo, Pixels
from slabcell_drivers.camera.simulated import SimulatedCamera
from slabcell_drivers.krc import SoftwareKrc
from slabcell_drivers.robot import Frame
from slabcell_drivers.robot.arm import ArmModel
from slabcell_drivers.simulation import Scene, World, camera_views, plane_views, render_board, render_world

__all__ = ["BoardPoses", "GripperWires", "SimulatedCell", "calibrate_from_boards", "shipped_programs"]

CHANNEL = "SlabCell"
TOOL_NUMBER, PICK_BASE_NUMBER, PLACE_BASE_NUMBER = 1, 1, 2
GRIP_OUTPUT, VACUUM_INPUT = 1, 1


def shipped_programs() -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Return the KRL files that are shipped for the controller, by name, and the EKI configurations, by channel."""
    folder: Traversable = files("slabcell") / "data" / "krl"
    programs: dict[str, bytes] = {}
    channels: dict[str, bytes] = {}
    for item in folder.iterdir():
        if item.name.lower().endswith((".src", ".dat")):
            programs[item.name] = item.read_bytes()
        elif item.name.lower().endswith(".xml"):
            channels[item.name.rpartition(".")[0]] = item.read_bytes()
    return programs, channels


class GripperWires:
    """The wires between the controller's I/O and the gripper in the world; also tells the world where the tool is.

    Called from the controller's thread alone, which is the one that changes the world; pictures are rendered from
    snapshots of it.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self.set_input: Callable[[int, bool], None] | None = None

    def output_changed(self, index: int, value: bool, tcp: Frame) -> None:  # noqa: FBT001 - the wire's own signature
        """Grip or release when the controller sets the gripper's output."""
        if index != GRIP_OUTPUT:
            return
        if value:
            self._world.grip(tcp)
        else:
            self._world.release(tcp)
        if self.set_input is not None:
            self.set_input(VACUUM_INPUT, self._world.vacuum)

    def moved(self, tcp: Frame) -> None:
        """Carry what the gripper holds along with the tool."""
        self._world.moved(tcp)


class SimulatedCell:
    """World, camera and controller of one scene.  The controller's programs are the shipped ones."""

    def __init__(self, scene: Scene, seed: int, arm: ArmModel, tool: Frame) -> None:
        self.scene = scene
        self.world = World(scene, seed)
        self._arm = arm
        self._tool = tool
        spec = scene.camera
        info = CameraInfo(spec.vendor, spec.model, spec.serial, spec.width, spec.height, "Mono8")
        self.camera = SimulatedCamera(info, self.picture)
        self.board: Frame | None = None
        """Where the calibration board is, in the root; None if none is shown.  Slabs are not seen meanwhile."""

    def picture(self, frame_number: int) -> Pixels:
        """Return what the camera sees now, shape (height, width)."""
        scene, board = self.scene, self.board
        if board is None:
            return render_world(self.world, frame_number)
        seed = self.world.seed
        return render_board(scene.camera, scene.optics, scene.board, board, seed=seed, frame_number=frame_number)

    def strew(self, seed: int) -> None:
        """Take everything away and strew new slabs; a controller from before still moves what was there."""
        self.world = World(self.scene, seed)

    def controller(self, address: tuple[str, int], *, seed: int, speed: float | None = None) -> SoftwareKrc:
        """Return a controller with the shipped programs, taught this cell's tool and bases; EKI goes to ``address``.

        With ``speed`` it takes its time: 1 is as long as the arm does, 2 half of that.
        """
        programs, channels = shipped_programs()
        wires = GripperWires(self.world)
        krc = SoftwareKrc(
            programs,
            robot=self._arm,
            eki_configs={CHANNEL: channels[CHANNEL]},
            eki_addresses={CHANNEL: address},
            io=wires,
            seed=seed,
            speed=speed,
        )
        wires.set_input = krc.set_input
        taught: Mapping[str, Frame] = {
            f"TOOL_DATA[{TOOL_NUMBER}]": self._tool,
            f"BASE_DATA[{PICK_BASE_NUMBER}]": self.scene.table.frame,
            f"BASE_DATA[{PLACE_BASE_NUMBER}]": self.scene.assembly.frame,
        }
        for name, frame in taught.items():
            krc.set_data("$CONFIG", name, frame)
        return krc


@dataclass(frozen=True, slots=True)
class BoardPoses:
    """Where the board is pictured: held up before the camera, and laid on the table, in the robot's root frame."""

    held: tuple[Frame, ...]
    laid: tuple[Frame, ...]

    @classmethod
    def of(cls, scene: Scene, seed: int) -> BoardPoses:
        """Return the poses for a scene."""
        return cls(tuple(camera_views(scene, seed)), tuple(plane_views(scene)))

    def __len__(self) -> int:
        """Return how many pictures that makes."""
        return len(self.held) + len(self.laid)


def calibrate_from_boards(
    scene: Scene, poses: BoardPoses, seed: int, done: Callable[[str], None]
) -> tuple[Calibration, CameraResult, PlaneResult]:
    """Calibrate the scene's camera as an integrator would: from pictures of a board, held up and laid on the table.

    The first board on the table lies at the table frame's origin, so that the table frame is the robot's pick base.
    ``done`` is called with the name of each picture.  Raises CalibrationError.
    """
    board = Board.parse(scene.board.name)

    frame_numbers = itertools.count()

    def pictures(kind: str, poses: Iterable[Frame]) -> Iterable[tuple[str, Pixels]]:
        for index, pose in enumerate(poses):
            number = next(frame_numbers)
            picture = render_board(scene.camera, scene.optics, scene.board, pose, seed=seed, frame_number=number)
            yield f"{kind} {index + 1}", picture

    held, failures = detect_boards(pictures("view", poses.held), board, done=done)
    laid, failures_on_table = detect_boards(pictures("table", poses.laid), board, done=done)
    if failures or failures_on_table:
        raise CalibrationError("\n".join(failures + failures_on_table))
    lens = calibrate_camera(held, board, serial=scene.camera.serial)
    plane = calibrate_plane(lens.calibration, laid, board, board_thickness_mm=scene.board.thickness_mm)
    return plane.calibration, lens, plane
