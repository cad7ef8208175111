"""Where do the slabs lie in a picture?  Pure: values in, values out; no device and no file."""

from slabcell.vision.locate import Locator, locate

__all__ = ["Locator", "locate"]
