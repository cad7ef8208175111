"""What text can a robot's display show?  One short line of ASCII."""

__all__ = ["MAX_MESSAGE_CHARS", "printable"]

MAX_MESSAGE_CHARS = 80
"""The message text of a SmartPAD message holds no more (KrlMsg_T.Msg_txt)."""


def printable(text: str) -> str:
    """Return the text as a robot can show it: one line of at most MAX_MESSAGE_CHARS characters of ASCII."""
    plain = text.encode("ascii", "replace").decode("ascii")
    return " ".join("".join(sign if sign.isprintable() else " " for sign in plain).split())[:MAX_MESSAGE_CHARS].rstrip()
