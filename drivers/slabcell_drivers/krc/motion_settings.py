"""How long does a setting behind WITH hold?  For one motion, one spline block or one segment of it."""

from collections.abc import Generator, Sequence
from contextlib import contextmanager

from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.values import Value, copy_value

__all__ = ["applied"]


@contextmanager
def applied(values: Sequence[tuple[str, Place, Value]]) -> Generator[None]:
    """Store values, and what was there before afterwards."""
    before = [(place, copy_value(place.value)) for _, place, _ in values]
    for _, place, value in values:
        place.set(value)
    try:
        yield
    finally:
        for place, value in before:
            if value is not None:
                place.set(value)
