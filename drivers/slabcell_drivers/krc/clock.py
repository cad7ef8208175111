"""What time is it in the cell?  Virtual seconds since the controller was switched on."""

__all__ = ["Clock"]


class Clock:
    """The virtual time; only the kernel moves it on."""

    __slots__ = ("now_s",)

    def __init__(self) -> None:
        self.now_s = 0.0
