"""Where do Harvesters and genicam enter the house?  Here alone: both are optional, and neither has type information."""

import importlib
from typing import Any, Final

__all__ = ["BUSY", "LOST", "ask", "core", "genapi", "gentl"]

core: Any = importlib.import_module("harvesters.core")
gentl: Any = importlib.import_module("genicam.gentl")
genapi: Any = importlib.import_module("genicam.genapi")

BUSY: Final = ("AccessDeniedException", "ResourceInUseException", "BusyException")
"""Names of the binding's errors of a camera that another client controls."""
LOST: Final = ("TimeoutException", "IoException", "InvalidHandleException", "InvalidIdException")
"""Names of the binding's errors of a camera that does not answer."""


def ask(thing: Any, name: str) -> Any:
    """Return an attribute that a producer may not have, None if it has not."""
    try:
        return getattr(thing, name)
    except (gentl.GenericException, genapi.GenericException, AttributeError):
        return None
