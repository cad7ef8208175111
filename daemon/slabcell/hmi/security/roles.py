"""What may somebody do?  Four roles, each of which may do what those below it may."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["Role"]


class Role(IntEnum):
    """Viewer: look.  Operator: run the cell.  Engineer: change what it does.  Admin: users, too."""

    VIEWER = 1
    OPERATOR = 2
    ENGINEER = 3
    ADMIN = 4

    @property
    def word(self) -> str:
        """Its name in files and addresses."""
        return self.name.lower()

    @classmethod
    def of(cls, word: str) -> Role:
        """Return the role of a name.  Raises ValueError."""
        try:
            return cls[word.upper()]
        except KeyError as error:
            msg = f"role {word!r:.40} is none of {', '.join(role.word for role in cls)}"
            raise ValueError(msg) from error
