"""What does a KRL file say?  .src, .dat and .sub to a `Module`, with every syntax error found on the way.

The parser takes what controllers' backups hold, also where a compiler would complain: the rules of the language
are checked apart from it (static.py).  lark makes the tokens; the structure is read by recursive descent, because KRL
has no reserved words to speak of, ends statements by lines, and an error must cost no more than its line.
"""

from slabcell_drivers.krc.lexer import MAX_SOURCE_BYTES, decode, tokenize
from slabcell_drivers.krc.parse_statements import StatementParser
from slabcell_drivers.krc.syntax import DataList, Diagnostic, Module, Parameter, Place, Routine, Statement
from slabcell_drivers.krc.token_stream import KrlSyntaxError

__all__ = ["parse"]


def parse(source: bytes | str, file: str) -> Module:
    """Return the module that a file holds; ``diagnostics`` lists its syntax errors in the order of the file."""
    if len(source) > MAX_SOURCE_BYTES:
        message = f"the file has {len(source)} bytes; at most {MAX_SOURCE_BYTES} are read"
        return Module(file, (), None, (), (Diagnostic(file, 1, 1, "error", "too-large", message),))
    text = decode(source) if isinstance(source, bytes) else source.replace("\r\n", "\n")
    return _FileParser(list(tokenize(text)), file).module()


class _FileParser(StatementParser):
    """Reads one file."""

    def module(self) -> Module:
        routines: list[Routine] = []
        data: DataList | None = None
        loose: list[Statement] = []
        self.skip_newlines()
        while not self.at("END_OF_FILE"):
            try:
                if self.at_word("GLOBAL") and self.ahead().word in {"DEF", "DEFFCT"}:
                    self.advance()
                    routines.append(self._routine(is_global=True))
                elif self.at_word("DEF", "DEFFCT"):
                    routines.append(self._routine(is_global=False))
                elif self.at_word("DEFDAT"):
                    found = self._data_list()
                    data = found if data is None else data
                elif self.at_word("END", "ENDFCT", "ENDDAT"):
                    self.note(KrlSyntaxError(self.token, "DEF, DEFFCT or DEFDAT"))
                    self.skip_line()
                else:
                    place = self.place
                    statements = self.block()
                    loose.extend(statements)
                    if not statements and self.place == place:
                        self.skip_line()
            except KrlSyntaxError as error:
                self.depth = 0
                self.note(error)
                self.skip_line()
        diagnostics = sorted(self.diagnostics, key=lambda d: (d.line, d.column))
        return Module(self.file, tuple(routines), data, tuple(loose), tuple(diagnostics))

    def _written_name(self, what: str, *, stop: frozenset[str] = frozenset()) -> str:
        """Return a name as written, also one that no variable may have: ``3D_TEST``, ``A-B``, ``/R1/X``."""
        parts: list[str] = []
        while self.token.kind not in {"LPAR", "LSQB", "NEWLINE", "END_OF_FILE"} and self.token.word not in stop:
            parts.append(self.advance().word)
        if not parts:
            raise KrlSyntaxError(self.token, what)
        return "".join(parts)

    def _routine(self, *, is_global: bool) -> Routine:
        place = self.place
        with_result = self.advance().word == "DEFFCT"
        name, result_type, is_array, parameters = "", "", False, ()
        try:
            if with_result:
                result_type = self.expect("NAME", "the type of the result").word
                is_array = self.at("LSQB")
                if is_array:
                    self.indices()
            name = self._written_name("the name of the routine")
            if self.at("LSQB"):
                is_array = True
                self.indices()
            parameters: tuple[Parameter, ...] = self.parameters() if self.at("LPAR") else ()
            self.end_line()
        except KrlSyntaxError as error:
            self.depth = 0
            self.note(error)
            self.skip_line()
        body = self.block()
        end = self._close_routine(place, "ENDFCT" if with_result else "END")
        return Routine(place, name, parameters, result_type, is_array, body, is_global, end)

    def _close_routine(self, opener: Place, word: str) -> Place:
        end = self.place
        if self.at_word(word):
            self.skip_line()
        elif self.at_word("END", "ENDFCT", "ENDDAT"):
            self.note(KrlSyntaxError(self.token, word))
            self.skip_line()
        else:
            self.report(opener, f"expected {word}: this routine is never closed", code="unclosed")
        return end

    def _data_list(self) -> DataList:
        place = self.place
        self.advance()
        name = self._written_name("the name of the data list", stop=frozenset({"PUBLIC"}))
        if self.at("LPAR"):
            self.arguments()
        is_public = self.accept_word("PUBLIC")
        try:
            self.end_line()
        except KrlSyntaxError as error:
            self.note(error)
            self.skip_line()
        body = self.block()
        self._close_routine(place, "ENDDAT")
        return DataList(place, name, is_public, body)
