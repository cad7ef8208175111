"""Lights: what one can do (`protocol`), how its family speaks (`presets`), and how it goes with the pictures."""

from slabcell_drivers.light.lit_camera import LightMode, LightPlan, LitCamera
from slabcell_drivers.light.presets import Preset, PresetError, load_presets
from slabcell_drivers.light.protocol import (
    Light,
    LightConfigError,
    LightError,
    LightInfo,
    LightLost,
    LightRefused,
    LightSetting,
    LightState,
)
from slabcell_drivers.light.serial_light import SerialLight
from slabcell_drivers.light.simulated import SimulatedController, SimulatedLight

__all__ = [
    "Light",
    "LightConfigError",
    "LightError",
    "LightInfo",
    "LightLost",
    "LightMode",
    "LightPlan",
    "LightRefused",
    "LightSetting",
    "LightState",
    "LitCamera",
    "Preset",
    "PresetError",
    "SerialLight",
    "SimulatedController",
    "SimulatedLight",
    "load_presets",
]
