"""How do values come back into a data list?  The text of a .dat with what its variables hold now.

The controller keeps the values of data lists over power-off by writing them into the file.  So does this: initial
values are replaced where they stand, comments and layout stay, elements of arrays that had no line get one.
"""

from collections.abc import Iterator, Mapping

from slabcell_drivers.krc.cells import Cell, Place
from slabcell_drivers.krc.lexer import decode
from slabcell_drivers.krc.syntax import Assign, DataList, Declaration, Declarator, Index, Literal, Name
from slabcell_drivers.krc.values import ArrayValue, CharArray, StructValue, Value, text_of

__all__ = ["written_back"]

Edit = tuple[int, int, int, str]  # line from 0, columns from and to, new text


def written_back(source: bytes, data: DataList, values: Mapping[str, Place]) -> bytes:
    """Return the file with the present values of its variables, in latin-1 with the line ends it had."""
    lines = decode(source).split("\n")
    edits: list[Edit] = []
    added: dict[int, list[str]] = {}
    written: set[tuple[str, str]] = set()
    for statement in data.body:
        if isinstance(statement, Assign):
            target = _element(statement)
            if target is not None and target[0] in values:
                written.add(target)
                edits.extend(_edit_assignment(statement, lines, values[target[0]], target[1]))
    for statement in data.body:
        if isinstance(statement, Declaration) and not statement.is_const:
            for declarator in statement.names:
                place = values.get(declarator.name)
                if isinstance(place, Cell) and not declarator.name.startswith("$"):
                    edits.extend(_edit_declaration(declarator, lines, place))
                    added.setdefault(declarator.place.line - 1, []).extend(
                        f"{declarator.name}{index}={text}"
                        for index, text in _elements(place.value)
                        if (declarator.name, index) not in written and declarator.value is None
                    )
    for line, start, end, text in sorted(edits, reverse=True):
        lines[line] = lines[line][:start] + text + lines[line][end:]
    for line in sorted(added, reverse=True):
        lines[line + 1 : line + 1] = added[line]
    end_of_line = "\r\n" if b"\r\n" in source else "\n"
    return end_of_line.join(lines).encode("latin-1", "replace")


def _element(statement: Assign) -> tuple[str, str] | None:
    """Return name and index text of ``NAME[1,2]=…``, ``NAME[]=…`` or ``NAME=…``; None for other targets."""
    target = statement.target
    if isinstance(target, Name):
        return target.name, ""
    if not isinstance(target, Index) or not isinstance(target.base, Name):
        return None
    parts = [str(i.value) if isinstance(i, Literal) else "" for i in target.indices]
    return target.base.name, f"[{','.join(parts)}]"


def _elements(value: Value) -> Iterator[tuple[str, str]]:
    """Yield index and text of every element that has a value."""
    if isinstance(value, CharArray) and value.text is not None:
        yield "[]", text_of(value)
    if not isinstance(value, ArrayValue):
        return
    for offset, item in enumerate(value.items):
        indices: list[int] = []
        rest = offset
        for size in reversed(value.sizes):
            indices.insert(0, rest % size + 1)
            rest //= size
        index = ",".join(map(str, indices))
        if isinstance(item, CharArray):
            if item.text is not None:
                yield f"[{index},]", text_of(item)
        elif _has_value(item):
            yield f"[{index}]", text_of(item)


def _has_value(value: Value) -> bool:
    if isinstance(value, StructValue):
        return any(_has_value(item) for item in value.fields.values())
    if isinstance(value, CharArray):
        return value.text is not None
    if isinstance(value, ArrayValue):
        return any(_has_value(item) for item in value.items)
    return value is not None


def _edit_assignment(statement: Assign, lines: list[str], place: Place, index: str) -> Iterator[Edit]:
    line = statement.place.line - 1
    text = lines[line]
    start = text.find("=", statement.place.column - 1)
    present = dict(_elements(place.value)).get(index) if index else text_of(place.value)
    if start >= 0 and present is not None and present != "?":
        yield line, start + 1, _end_of_value(text, start + 1), present


def _edit_declaration(declarator: Declarator, lines: list[str], place: Cell) -> Iterator[Edit]:
    value = place.value
    if isinstance(value, ArrayValue) or not _has_value(value):
        return
    line = declarator.place.line - 1
    text = lines[line]
    after = declarator.place.column - 1 + len(declarator.name)
    rest = text[after:]
    if rest.lstrip().startswith("["):
        after = text.index("]", after) + 1
        rest = text[after:]
    if rest.lstrip().startswith("="):
        start = text.index("=", after) + 1
        yield line, start, _end_of_value(text, start), text_of(value)
    elif not isinstance(value, CharArray):
        yield line, after, after, f"={text_of(value)}"


def _end_of_value(text: str, start: int) -> int:
    depth, quoted = 0, False
    for position in range(start, len(text)):
        letter = text[position]
        if letter == '"':
            quoted = not quoted
        elif quoted:
            continue
        elif letter in "{[(":
            depth += 1
        elif letter in "}])":
            depth -= 1
        elif letter == ";" or (letter == "," and depth == 0):
            return len(text[:position].rstrip())
    return len(text.rstrip())
