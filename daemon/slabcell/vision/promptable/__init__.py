"""Which pixels belong to slabs, asked of a promptable model?  Segment Anything and its relatives, through onnxruntime.

The model's files are the user's, and onnxruntime is the optional extra ``slabcell[sam]``: nothing here is imported, and
no file is opened, unless a recipe's segmentation method is ``promptable``.
"""

from slabcell.vision.promptable.errors import ModelError

__all__ = ["ModelError"]
