"""How are a camera's GenICam features read and set through Harvesters?  Its node map, checked and read back."""

from typing import Any, Final

from slabcell_drivers.camera.features import remedy
from slabcell_drivers.camera.genicam_binding import LOST, ask, genapi
from slabcell_drivers.camera.protocol import CameraConfigError
from slabcell_drivers.camera.settings import FeatureValue

__all__ = ["HarvestersFeatures"]

_NUMBERS: Final = ("IInteger", "IFloat")


class HarvestersFeatures:
    """The features of one open camera.  Errors of a camera that does not answer are the binding's own."""

    def __init__(self, nodes: Any, camera: str) -> None:
        self._nodes = nodes
        self._camera = camera

    def has(self, name: str) -> bool:
        """Whether the camera has the feature."""
        return bool(self._nodes.has_node(name))

    def get(self, name: str) -> FeatureValue:
        """Return a feature's value.  Raises CameraConfigError."""
        return self._node(name).value

    def set(self, name: str, value: FeatureValue) -> None:
        """Set a feature and read it back; a command is executed.  Raises CameraConfigError."""
        node = self._node(name)
        kind = type(node).__name__
        if kind == "ICommand":
            node.execute()
            return
        takes = _takes(node, kind)
        low, high = ask(node, "min"), ask(node, "max")
        outside = kind in _NUMBERS and low is not None and not low <= float(value) <= high
        if outside or (kind == "IEnumeration" and value not in node.symbolics):
            raise self._refused(name, value, takes)
        try:
            node.value = value
            seen = node.value
        except (genapi.GenericException, TypeError) as error:
            if type(error).__name__ in LOST:
                raise
            raise self._refused(name, value, f"{takes} ({error})") from error
        same = bool(seen == value)
        if kind == "IFloat":
            # Cameras round to their own steps (a line time, 0.1 dB): half a percent, or a hundredth of a unit.
            same = abs(float(seen) - float(value)) <= max(0.005 * abs(float(value)), 0.011)
        if not same:
            raise CameraConfigError(
                f"camera {self._camera}: {name} was set to {value} and reads {seen}: {takes};"
                f" {remedy(self._camera, name)}"
            )

    def _node(self, name: str) -> Any:
        if not self.has(name):
            raise CameraConfigError(f"camera {self._camera}: has no feature {name}; {remedy(self._camera)}")
        return getattr(self._nodes, name)

    def _refused(self, name: str, value: FeatureValue, takes: str) -> CameraConfigError:
        return CameraConfigError(
            f"camera {self._camera}: {name} = {value} is refused: {takes}; {remedy(self._camera, name)}"
        )


def _takes(node: Any, kind: str) -> str:
    """Say which values a feature takes."""
    if kind == "IEnumeration":
        return f"it takes {', '.join(node.symbolics)}"
    low, high = ask(node, "min"), ask(node, "max")
    if kind in _NUMBERS and low is not None and high is not None:
        step = ask(node, "inc") if kind == "IInteger" else None
        return f"it must be {low:.10g} to {high:.10g}" + (f" in steps of {step}" if step and step > 1 else "")
    return "the camera does not take it"
