"""What is wrong with a promptable model?  One error, with what to do about it."""

from typing import Final

from slabcell.errors import ConfigurationError

__all__ = ["ModelError"]

# MODEL_UNUSABLE in the error catalogue.
NUMBER: Final = 1505


class ModelError(ConfigurationError):
    """onnxruntime or a model file is missing, or a file is not of a model that is known."""

    def __init__(self, message: str) -> None:
        super().__init__(message, number=NUMBER)
