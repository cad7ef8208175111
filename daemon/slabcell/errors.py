"""What can go wrong in the controller: one exception tree, and the exit code each branch ends a command with.

::

    SlabcellError                 exit 1   the work failed
    ├── UsageError                exit 2   a command was called wrongly
    ├── ConfigurationError        exit 78  a file that a person wrote is wrong
    │   ├── TemplateError
    │   └── RecipeError
    ├── CalibrationError          exit 78  a calibration is missing, damaged or of another camera
    ├── ImageError                exit 1   a picture cannot be read or used
    ├── UnavailableError          exit 69  a device or the daemon does not answer
    ├── NotPermittedError         exit 77  the user has no right to do this
    └── TemporaryError            exit 75  the same call may succeed later

Every message names the thing, the value, the limit and what to do next.
"""

from typing import ClassVar

__all__ = [
    "CalibrationError",
    "ConfigurationError",
    "ImageError",
    "NotPermittedError",
    "RecipeError",
    "SlabcellError",
    "TemplateError",
    "TemporaryError",
    "UnavailableError",
    "UsageError",
]


class SlabcellError(Exception):
    """Root of the tree.  ``number`` is the entry in the error catalogue, 0 where there is none."""

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str, *, number: int = 0) -> None:
        super().__init__(message)
        self.number = number


class UsageError(SlabcellError):
    """A command was called with arguments that contradict each other."""

    exit_code = 2


class ConfigurationError(SlabcellError):
    """A file that a person wrote is wrong: the message names file, place, value and remedy."""

    exit_code = 78


class TemplateError(ConfigurationError):
    """A template file is wrong.  ``problems`` lists every problem found, in the order of the file."""

    def __init__(self, message: str, *, problems: tuple[str, ...] = (), number: int = 0) -> None:
        super().__init__(message, number=number)
        self.problems = problems or (message,)


class RecipeError(ConfigurationError):
    """A recipe file is wrong."""


class CalibrationError(SlabcellError):
    """A calibration is missing, damaged, of another camera, or cannot be made from what was given."""

    exit_code = 78


class ImageError(SlabcellError):
    """A picture cannot be read, or cannot be used for what was asked."""


class UnavailableError(SlabcellError):
    """A device or the daemon does not answer."""

    exit_code = 69


class NotPermittedError(SlabcellError):
    """The user has no right to do this."""

    exit_code = 77


class TemporaryError(SlabcellError):
    """The same call may succeed later."""

    exit_code = 75
