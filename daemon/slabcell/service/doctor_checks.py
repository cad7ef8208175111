"""Which questions does `slabcell doctor` ask?  One table, from which its page in the documentation is drawn."""

from slabcell.service import doctor_files as files
from slabcell.service import doctor_robot as robot
from slabcell.service import doctor_system as system
from slabcell.service.doctor import Check

__all__ = ["CHECKS"]

CHECKS: tuple[Check, ...] = (
    Check(1, "configuration", "reference/configuration.md", files.look_at_configuration),
    Check(2, "recipe", "reference/vision.md", files.look_at_recipe),
    Check(3, "calibration", "how-to/calibrate.md", files.look_at_calibration),
    Check(4, "robot programs", "how-to/install-krl.md", files.look_at_programs),
    Check(5, "state directory", "reference/ledger.md", files.look_at_state),
    Check(6, "clock", "reference/faults.md", files.look_at_clock),
    Check(7, "camera", "how-to/camera.md", system.look_at_camera),
    Check(8, "camera's network", "reference/cameras.md", system.look_at_link),
    Check(9, "socket buffer", "how-to/install-service.md", system.look_at_buffers),
    Check(10, "robot's network", "reference/eki-channel.md", robot.look_at_robot),
    Check(11, "service", "how-to/install-service.md", system.look_at_unit),
    Check(12, "daemon", "reference/control-api.md", system.look_at_daemon),
)
"""In this order: a later one may need what an earlier one has read."""
