"""The simulated cell: scenes, the world's truth, pictures of it, and calibration boards."""

from slabcell_drivers.simulation.boards import board_corners, camera_views, plane_views, render_board
from slabcell_drivers.simulation.defects import broken, chipped, touching
from slabcell_drivers.simulation.obstructions import arm_in_view, hand_in_view
from slabcell_drivers.simulation.placement import Placement
from slabcell_drivers.simulation.rendering import render_slabs, render_world
from slabcell_drivers.simulation.scene import Scene, SceneError, load_scene
from slabcell_drivers.simulation.slab import Slab
from slabcell_drivers.simulation.world import Event, EventKind, GripperFaults, World, strewn_slabs

__all__ = [
    "Event",
    "EventKind",
    "GripperFaults",
    "Placement",
    "Scene",
    "SceneError",
    "Slab",
    "World",
    "arm_in_view",
    "board_corners",
    "broken",
    "camera_views",
    "chipped",
    "hand_in_view",
    "load_scene",
    "plane_views",
    "render_board",
    "render_slabs",
    "render_world",
    "strewn_slabs",
    "touching",
]
