"""The simulated cell: scenes, the world's truth, pictures of it, and calibration boards."""

from slabcell_drivers.simulation.boards import board_corners, camera_views, plane_views, render_board
from slabcell_drivers.simulation.placement import Placement
from slabcell_drivers.simulation.rendering import render_slabs, render_world
from slabcell_drivers.simulation.scene import Scene, SceneError, load_scene
from slabcell_drivers.simulation.slab import Slab
from slabcell_drivers.simulation.world import Event, EventKind, GripperFaults, World

__all__ = [
    "Event",
    "EventKind",
    "GripperFaults",
    "Placement",
    "Scene",
    "SceneError",
    "Slab",
    "World",
    "board_corners",
    "camera_views",
    "load_scene",
    "plane_views",
    "render_board",
    "render_slabs",
    "render_world",
]
