"""Which types do KRL values have?"""

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = [
    "BOOL",
    "CHAR",
    "INT",
    "POSITION_FIELDS",
    "REAL",
    "ArrayType",
    "EnumConstant",
    "EnumType",
    "KrlType",
    "ScalarType",
    "StructType",
]


@dataclass(frozen=True, slots=True)
class ScalarType:
    """INT, REAL, BOOL or CHAR."""

    name: str


INT, REAL, BOOL, CHAR = ScalarType("INT"), ScalarType("REAL"), ScalarType("BOOL"), ScalarType("CHAR")


@dataclass(frozen=True, slots=True)
class EnumType:
    """An enumeration; ``values`` is empty where every value is taken."""

    name: str
    values: frozenset[str]


@dataclass(frozen=True, slots=True, eq=False)
class StructType:
    """A structure with its members in their order."""

    name: str
    members: Mapping[str, "KrlType"]
    is_flat: bool = field(default=True)


@dataclass(frozen=True, slots=True)
class ArrayType:
    """An array of one to three dimensions; 0 stands for a size that the argument brings."""

    element: "KrlType"
    sizes: tuple[int, ...]

    @property
    def name(self) -> str:
        """The name as a declaration would write it."""
        return f"{self.element.name}[{','.join(str(s) if s else '' for s in self.sizes)}]"


KrlType = ScalarType | EnumType | StructType | ArrayType


@dataclass(frozen=True, slots=True)
class EnumConstant:
    """``#NAME``: the same name is the same value, whichever enumeration it comes from."""

    name: str

    def __str__(self) -> str:
        """Return it as KRL writes it."""
        return f"#{self.name}"


POSITION_FIELDS: dict[str, tuple[str, ...]] = {
    "FRAME": ("X", "Y", "Z", "A", "B", "C"),
    "POS": ("X", "Y", "Z", "A", "B", "C", "S", "T"),
    "E6POS": ("X", "Y", "Z", "A", "B", "C", "S", "T", "E1", "E2", "E3", "E4", "E5", "E6"),
    "E3POS": ("X", "Y", "Z", "A", "B", "C", "S", "T", "E1", "E2", "E3"),
    "AXIS": ("A1", "A2", "A3", "A4", "A5", "A6"),
    "E3AXIS": ("A1", "A2", "A3", "A4", "A5", "A6", "E1", "E2", "E3"),
    "E6AXIS": ("A1", "A2", "A3", "A4", "A5", "A6", "E1", "E2", "E3", "E4", "E5", "E6"),
}
