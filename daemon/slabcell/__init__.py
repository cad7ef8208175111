"""slabcell: the controller of a robot cell that lays irregular flat slabs into a given pattern."""

from importlib.metadata import version

__all__ = ["__version__"]

__version__ = version("slabcell")
