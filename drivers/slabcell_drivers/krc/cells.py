"""Where is a KRL value kept?  Variables, parts of them, and system variables, all read and written the same way."""

from collections.abc import Callable
from enum import Enum
from typing import Protocol

from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.values import ArrayValue, CharArray, KrlType, StructValue, Value, coercer, fresh, text_of

__all__ = [
    "NO_TRAITS",
    "Cell",
    "ComputedCell",
    "Container",
    "DynamicArray",
    "ElementRef",
    "MemberRef",
    "Place",
    "TextRef",
    "Trait",
]


class Trait(Enum):
    """What an access to a system variable means for the run of the program."""

    STOPS_ADVANCE = "the advance run waits for the main run"
    TIME = "changes as time goes by, without any event"


NO_TRAITS: frozenset[Trait] = frozenset()


class Place(Protocol):
    """Something that holds a value."""

    @property
    def value(self) -> Value:
        """The value, None if it was never set."""
        ...

    def set(self, value: Value) -> None:
        """Store a value, converted to the type of the place.  Raises KrlError."""
        ...


class Container(Protocol):
    """Something with elements: arrays, texts, and the arrays of the system."""

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return an element."""
        ...

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Store an element."""
        ...


def _as_it_is(value: Value) -> Value:
    return value


class Cell:
    """A variable; without a type it takes whatever is stored first.  ``traits`` are those of a system variable."""

    __slots__ = ("coerce", "is_const", "name", "traits", "type", "value")

    def __init__(
        self, name: str, type_: KrlType | None, *, is_const: bool = False, traits: frozenset[Trait] = NO_TRAITS
    ) -> None:
        self.name = name
        self.traits = traits
        self.type = type_
        self.coerce: Callable[[Value], Value] = _as_it_is if type_ is None else coercer(type_)
        self.value: Value = None if type_ is None else fresh(type_)
        self.is_const = is_const

    def set(self, value: Value) -> None:
        """Store a value, converted to the type of the variable."""
        if self.is_const:
            raise KrlError(RunMessage.READ_ONLY, f"{self.name} is a constant")
        self.value = self.coerce(value)


class ComputedCell:
    """A system variable that is read from the controller, and written to it where that is allowed."""

    __slots__ = ("_read", "_write", "name", "traits", "type")

    def __init__(
        self,
        name: str,
        type_: KrlType | None,
        read: Callable[[], Value],
        write: Callable[[Value], None] | None = None,
        *,
        traits: frozenset[Trait] = NO_TRAITS,
    ) -> None:
        self.name = name
        self.traits = traits
        self.type = type_
        self._read = read
        self._write = write

    @property
    def value(self) -> Value:
        """What the controller says now."""
        return self._read()

    def set(self, value: Value) -> None:
        """Store a value.  Raises KrlError if the variable is write-protected."""
        if self._write is None:
            raise KrlError(RunMessage.READ_ONLY, f"{self.name} is write-protected")
        self._write(value if self.type is None else coercer(self.type)(value))


class DynamicArray:
    """An array of the system whose size and type this software does not know."""

    __slots__ = ("items",)

    def __init__(self) -> None:
        self.items: dict[tuple[Value, ...], Value] = {}

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return an element, None if it was never set."""
        return self.items.get(indices)

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Store an element."""
        self.items[indices] = value


class MemberRef:
    """A member of a structure."""

    __slots__ = ("_name", "_parent")

    def __init__(self, parent: Place, name: str) -> None:
        self._parent = parent
        self._name = name

    @property
    def value(self) -> Value:
        """The member."""
        structure = self._parent.value
        if not isinstance(structure, StructValue):
            raise KrlError(RunMessage.TYPE, f"{text_of(structure)} is no structure and has no member {self._name}")
        return structure.get(self._name)

    def set(self, value: Value) -> None:
        """Store the member."""
        structure = self._parent.value
        if structure is None:  # a system variable of unknown structure
            self._parent.set(StructValue(None, {self._name: value}))
            return
        if not isinstance(structure, StructValue):
            raise KrlError(RunMessage.TYPE, f"{text_of(structure)} is no structure and has no member {self._name}")
        if isinstance(self._parent, ComputedCell):  # a computed value is a copy: change it and give it back
            structure = structure.copy()
            structure.set(self._name, value)
            self._parent.set(structure)
        else:
            structure.set(self._name, value)


class ElementRef:
    """An element of an array."""

    __slots__ = ("_indices", "_parent")

    def __init__(self, parent: Place, indices: tuple[Value, ...]) -> None:
        self._parent = parent
        self._indices = indices

    def _container(self) -> Container:
        container = self._parent.value
        if container is None:
            container = DynamicArray()
            self._parent.set(container)
        if isinstance(container, ArrayValue) and len(self._indices) == len(container.sizes) + 1:
            row = container.get(self._indices[:-1])
            if isinstance(row, CharArray):
                self._indices = self._indices[-1:]
                self._parent = TextRef(row)
                return row
        if isinstance(container, StructValue) or not hasattr(container, "get"):
            raise KrlError(RunMessage.TYPE, f"{text_of(container)} is no array")
        return container

    @property
    def value(self) -> Value:
        """The element."""
        return self._container().get(self._indices)

    def set(self, value: Value) -> None:
        """Store the element."""
        self._container().set(self._indices, value)


class TextRef:
    """A whole text, ``x[]`` or one row of an array of texts."""

    __slots__ = ("value",)

    def __init__(self, text: CharArray) -> None:
        self.value = text

    def set(self, value: Value) -> None:
        """Store a text."""
        self.value.assign(value)
