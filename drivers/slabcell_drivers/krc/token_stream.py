"""Where does the parser stand in a file, and how does it say what it expected there?"""

from slabcell_drivers.krc.lexer import Token
from slabcell_drivers.krc.syntax import Diagnostic, Place

__all__ = ["KrlSyntaxError", "TokenStream"]


class KrlSyntaxError(Exception):
    """A token that cannot stand here; caught by the statement parser, which notes it and goes on with the next line."""

    def __init__(self, token: Token, expected: str) -> None:
        super().__init__(expected)
        self.token = token
        self.expected = expected


class TokenStream:
    """The tokens of one file with a place in it, and the diagnostics found so far."""

    def __init__(self, tokens: list[Token], file: str) -> None:
        self.tokens = tokens
        self.file = file
        self.index = 0
        self.diagnostics: list[Diagnostic] = []

    @property
    def token(self) -> Token:
        """The token at the place."""
        return self.tokens[self.index]

    @property
    def place(self) -> Place:
        """The place as line and column."""
        token = self.tokens[self.index]
        return Place(token.line, token.column)

    def ahead(self, count: int = 1) -> Token:
        """Return a token further on; at the end of the file, the END_OF_FILE token."""
        return self.tokens[min(self.index + count, len(self.tokens) - 1)]

    def advance(self) -> Token:
        """Return the token at the place and step over it."""
        token = self.tokens[self.index]
        if self.index < len(self.tokens) - 1:
            self.index += 1
        return token

    def at(self, kind: str) -> bool:
        """Tell whether a token of this kind stands here."""
        return self.tokens[self.index].kind == kind

    def at_word(self, *words: str) -> bool:
        """Tell whether one of these words stands here."""
        token = self.tokens[self.index]
        return token.kind == "NAME" and token.word in words

    def accept(self, kind: str) -> bool:
        """Step over a token of this kind if it stands here."""
        if self.tokens[self.index].kind == kind:
            self.advance()
            return True
        return False

    def accept_word(self, *words: str) -> bool:
        """Step over one of these words if it stands here."""
        if self.at_word(*words):
            self.advance()
            return True
        return False

    def expect(self, kind: str, what: str) -> Token:
        """Step over a token of this kind and return it.  Raises KrlSyntaxError if another stands here."""
        if self.tokens[self.index].kind != kind:
            raise KrlSyntaxError(self.token, what)
        return self.advance()

    def expect_word(self, *words: str) -> Token:
        """Step over one of these words and return it.  Raises KrlSyntaxError if something else stands here."""
        if not self.at_word(*words):
            raise KrlSyntaxError(self.token, " or ".join(words))
        return self.advance()

    def at_end_of_line(self) -> bool:
        """Tell whether the line ends here."""
        return self.tokens[self.index].kind in {"NEWLINE", "END_OF_FILE"}

    def end_line(self) -> None:
        """Step over the end of the line.  Raises KrlSyntaxError if something is left on it."""
        if not self.at_end_of_line():
            raise KrlSyntaxError(self.token, "the end of the line")
        self.skip_newlines()

    def skip_newlines(self) -> None:
        """Step over empty lines."""
        while self.tokens[self.index].kind == "NEWLINE":
            self.index += 1

    def skip_line(self) -> None:
        """Go to the start of the next line that holds something."""
        while not self.at_end_of_line():
            self.index += 1
        self.skip_newlines()

    def note(self, error: KrlSyntaxError) -> None:
        """Keep a syntax error as a diagnostic."""
        token = error.token
        if token.kind == "OPEN_STRING":
            message = 'the text has no closing "'
        else:
            shown = {"NEWLINE": "the end of the line", "END_OF_FILE": "the end of the file"}.get(token.kind)
            message = f"expected {error.expected}, found {shown or repr(token.text)}"
        self.report(Place(token.line, token.column), message, code="syntax")

    def report(self, place: Place, message: str, *, code: str) -> None:
        """Keep an error as a diagnostic."""
        self.diagnostics.append(Diagnostic(self.file, place.line, place.column, "error", code, message))
