"""How is a KRL statement read?  One statement a line, blocks between their words; an error costs its own line only."""

from collections.abc import Callable

from slabcell_drivers.krc.parse_declarations import DeclarationParser
from slabcell_drivers.krc.parse_motion import MOTIONS, MotionParser
from slabcell_drivers.krc.syntax import (
    Analog,
    Assign,
    Asynchronous,
    Call,
    CallStatement,
    Case,
    Confirm,
    Expr,
    For,
    Goto,
    If,
    Index,
    Interrupt,
    InterruptDecl,
    Keyword,
    Label,
    Literal,
    Loop,
    Member,
    Name,
    Place,
    Repeat,
    Return,
    Statement,
    Switch,
    Trigger,
    Wait,
    While,
)
from slabcell_drivers.krc.token_stream import KrlSyntaxError

__all__ = ["StatementParser"]

_WORDS = frozenset({"EXIT", "HALT", "CONTINUE", "RESUME", "ON_ERROR_PROCEED"})
_CLOSERS = frozenset(
    {"ENDIF", "ELSE", "ENDSWITCH", "CASE", "DEFAULT", "ENDFOR", "ENDWHILE", "UNTIL", "ENDLOOP", "ENDSPLINE"}
)
_ENDS = frozenset({"END", "ENDFCT", "ENDDAT", "DEF", "DEFFCT", "DEFDAT"})
_MAX_BLOCKS = 64


class StatementParser(DeclarationParser, MotionParser):
    """Reads statements and blocks."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # pyright: ignore[reportArgumentType]  # the stream's own arguments, passed on
        self._open: list[tuple[str, ...]] = []
        self._unclosed = False
        self._handlers: dict[str, Callable[[Place], Statement]] = {
            "IF": self._if,
            "SWITCH": self._switch,
            "FOR": self._for,
            "WHILE": self._while,
            "REPEAT": self._repeat,
            "LOOP": self._loop,
            "GOTO": self._goto,
            "RETURN": self._return,
            "WAIT": self._wait,
            "CONFIRM": self._confirm,
            "INTERRUPT": self._interrupt,
            "TRIGGER": self._trigger,
            "BRAKE": self._brake,
            "ANIN": self._analog,
            "ANOUT": self._analog,
            "DIGIN": self._analog,
            "ASYPTP": self._asynchronous,
            "ASYCONT": self._asynchronous,
            "ASYSTOP": self._asynchronous,
            "ASYCANCEL": self._asynchronous,
            "SPLINE": self.spline,
            "PTP_SPLINE": self.spline,
            "TIME_BLOCK": self.spline_condition,
            "CONST_VEL": self.spline_condition,
            "STOP": self.spline_condition,
        }

    def at_routine_end(self) -> bool:
        """Tell whether a word that ends or begins a routine stands here."""
        token = self.token
        if token.kind == "END_OF_FILE":
            return True
        if token.kind != "NAME":
            return False
        if token.word == "GLOBAL":
            return self.ahead().kind == "NAME" and self.ahead().word in {"DEF", "DEFFCT"}
        return token.word in _ENDS and self.ahead().kind not in {"ASSIGN", "DOT", "LSQB", "COLON"}

    def block(self, *closers: str) -> tuple[Statement, ...]:
        """Return the statements up to one of these words, which stays where it is; errors are noted."""
        self._open.append(closers)
        found: list[Statement] = []
        self.skip_newlines()
        while not self.at_routine_end():
            token = self.token
            closing = (
                token.kind == "NAME" and token.word in _CLOSERS and self.ahead().kind not in {"ASSIGN", "DOT", "LSQB"}
            )
            if closing:
                if token.word in closers:
                    break
                if any(token.word in outer for outer in self._open):
                    break
                self.note(KrlSyntaxError(token, "a statement: nothing that this word closes is open"))
                self.skip_line()
                continue
            self._statement_line(found)
        self._open.pop()
        return tuple(found)

    def _statement_line(self, found: list[Statement]) -> None:
        start = self.index
        try:
            if self.at_declaration() and not self._at_statement_word():
                found.extend(self.declaration())
            else:
                statement = self.statement()
                found.append(statement)
                if isinstance(statement, Label):
                    self.skip_newlines()
                    return
            if self._unclosed:
                self._unclosed = False
            else:
                self.end_line()
        except KrlSyntaxError as error:
            self.depth = 0
            self.note(error)
            if self.index == start and self.at_end_of_line():
                self.advance()
            self.skip_line()

    def _at_statement_word(self) -> bool:
        """Tell whether two names in a row begin a statement: ``WAIT FOR``, ``PTP P1``, ``GLOBAL INTERRUPT``."""
        word = self.token.word
        if word == "GLOBAL":
            return self.ahead().word == "INTERRUPT"
        return word in self._handlers or word in _WORDS or word in MOTIONS

    def close(self, opener: Place, *words: str) -> str:
        """Step over the word that closes a block and return it.  A missing one is noted at its opener, once."""
        if self.at_word(*words):
            return self.advance().word
        self.report(
            opener,
            f"expected {' or '.join(words)} before line {self.token.line}, column {self.token.column}: "
            f"this block is never closed",
            code="unclosed",
        )
        self._unclosed = True
        return ""

    def statement(self) -> Statement:
        """Return the statement that begins here.  Raises KrlSyntaxError."""
        place, token, after = self.place, self.token, self.ahead()
        if token.kind != "NAME":
            raise KrlSyntaxError(token, "a statement")
        word = token.word
        if after.kind in {"ASSIGN", "DOT", "LSQB"}:
            return self.assignment()
        if after.kind == "COLON":
            self.advance()
            self.advance()
            return Label(place, word)
        if len(self._open) > _MAX_BLOCKS:
            raise KrlSyntaxError(token, f"at most {_MAX_BLOCKS} blocks within each other")
        if word == "GLOBAL" and after.word == "INTERRUPT":
            self.advance()
            return self._interrupt(place, is_global=True)
        if word in MOTIONS:
            return self.motion(place)
        handler = self._handlers.get(word)
        if handler is not None:
            return handler(place)
        if word in _WORDS:
            self.advance()
            return Keyword(place, word)
        return self.assignment()

    def assignment(self) -> Statement:
        """Return an assignment or a call: what a TRIGGER may do, too."""
        place = self.place
        target = self.postfix()
        if self.at("ASSIGN"):
            if not isinstance(target, Name | Index | Member):
                raise KrlSyntaxError(self.token, "a variable before '='")
            self.advance()
            return Assign(place, target, self.expression())
        if isinstance(target, Call):
            return CallStatement(place, target)
        raise KrlSyntaxError(self.token, "'=' or '('")

    def _heading(self, place: Place, word: str = "") -> Expr:
        """Return the expression of a block's first line.  An error in it is noted, so that the block still counts."""
        try:
            result = self.expression()
            if word:
                self.expect_word(word)
                self.skip_newlines()
            else:
                self.end_line()
        except KrlSyntaxError as error:
            self._note_heading(error)
            return Literal(place, value=False)
        return result

    def _note_heading(self, error: KrlSyntaxError) -> None:
        self.depth = 0
        self.note(error)
        self.skip_line()

    def _if(self, place: Place) -> Statement:
        self.advance()
        condition = self._heading(place, "THEN")
        then = self.block("ELSE", "ENDIF")
        otherwise: tuple[Statement, ...] = ()
        word = self.close(place, "ELSE", "ENDIF")
        if word == "ELSE":
            otherwise = self.block("ENDIF")
            self.close(place, "ENDIF")
        return If(place, condition, then, otherwise)

    def _switch(self, place: Place) -> Statement:
        self.advance()
        subject = self._heading(place)
        self._open.append(("CASE", "DEFAULT", "ENDSWITCH"))
        cases: list[Case] = []
        while self.at_word("CASE", "DEFAULT"):
            case_place = self.place
            values: list[Expr] = []
            try:
                if self.advance().word == "CASE":
                    values.append(self.expression())
                    while self.accept("COMMA"):
                        values.append(self.expression())
                self.accept("COLON")
                self.end_line()
            except KrlSyntaxError as error:
                self.note(error)
                self.skip_line()
            cases.append(Case(case_place, tuple(values), self.block("CASE", "DEFAULT", "ENDSWITCH")))
        self._open.pop()
        if not cases and not self.at_word("ENDSWITCH"):
            self.note(KrlSyntaxError(self.token, "CASE"))
            self.block("ENDSWITCH")
        self.close(place, "ENDSWITCH")
        return Switch(place, subject, tuple(cases))

    def _for(self, place: Place) -> Statement:
        self.advance()
        variable: Expr = Name(place, "")
        start = end = step = None
        try:
            variable = self.postfix()
            self.expect("ASSIGN", "'='")
            start = self.expression()
            self.expect_word("TO")
            end = self.expression()
            step = self.expression() if self.accept_word("STEP") else None
            self.end_line()
        except KrlSyntaxError as error:
            self._note_heading(error)
        body = self.block("ENDFOR")
        self.close(place, "ENDFOR")
        missing = Literal(place, value=0)
        return For(place, variable, start or missing, end or missing, step, body)

    def _while(self, place: Place) -> Statement:
        self.advance()
        condition = self._heading(place)
        body = self.block("ENDWHILE")
        self.close(place, "ENDWHILE")
        return While(place, condition, body)

    def _repeat(self, place: Place) -> Statement:
        self.advance()
        self.end_line()
        body = self.block("UNTIL")
        if not self.close(place, "UNTIL"):
            return Loop(place, body)
        return Repeat(place, body, self.expression())

    def _loop(self, place: Place) -> Statement:
        self.advance()
        self.end_line()
        body = self.block("ENDLOOP")
        self.close(place, "ENDLOOP")
        return Loop(place, body)

    def _goto(self, place: Place) -> Statement:
        self.advance()
        return Goto(place, self.expect("NAME", "a label").word)

    def _return(self, place: Place) -> Statement:
        self.advance()
        return Return(place, None if self.at_end_of_line() else self.expression())

    def _wait(self, place: Place) -> Statement:
        self.advance()
        kind = self.expect_word("FOR", "SEC").word
        return Wait(place, kind, self.expression())

    def _confirm(self, place: Place) -> Statement:
        self.advance()
        return Confirm(place, self.expression())

    def _brake(self, place: Place) -> Statement:
        self.advance()
        fast = self.accept_word("F", "FF")
        return Keyword(place, "BRAKE F" if fast else "BRAKE")

    def _action(self) -> Statement:
        """Return what an interrupt or trigger does: a call or an assignment, a single word in some programs."""
        if self.at_word(*_WORDS, "BRAKE") and self.ahead().kind not in {"ASSIGN", "DOT", "LSQB"}:
            return self.statement()
        return self.assignment()

    def _interrupt(self, place: Place, *, is_global: bool = False) -> Statement:
        self.advance()
        verb = self.expect_word("DECL", "ON", "OFF", "ENABLE", "DISABLE").word
        if verb != "DECL":
            return Interrupt(place, verb, None if self.at_end_of_line() else self.expression())
        number = self.expression()
        self.expect_word("WHEN")
        condition = self.expression()
        self.expect_word("DO")
        return InterruptDecl(place, number, condition, self._action(), is_global)

    def _trigger(self, place: Place) -> Statement:
        self.advance()
        self.expect_word("WHEN")
        kind = self.expect_word("DISTANCE", "PATH").word
        self.expect("ASSIGN", "'='")
        position = self.expression()
        on_start, delay = False, None
        while self.at_word("ONSTART", "DELAY"):
            if self.advance().word == "ONSTART":
                on_start = True
            else:
                self.expect("ASSIGN", "'='")
                delay = self.expression()
        self.expect_word("DO")
        action = self._action()
        priority = None
        if self.accept_word("PRIO"):
            self.expect("ASSIGN", "'='")
            priority = self.expression()
        return Trigger(place, kind, position, on_start, delay, action, priority)

    def _analog(self, place: Place) -> Statement:
        kind = self.advance().word
        verb = self.expect_word("ON", "OFF").word
        target = self.postfix()
        value = self.expression() if self.accept("ASSIGN") else None
        options: list[tuple[str, Expr]] = []
        while self.at_word("DELAY", "MINIMUM", "MAXIMUM"):
            name = self.advance().word
            self.expect("ASSIGN", "'='")
            options.append((name, self.expression()))
        return Analog(place, kind, verb, target, value, tuple(options))

    def _asynchronous(self, place: Place) -> Statement:
        verb = self.advance().word
        return Asynchronous(place, verb, None if self.at_end_of_line() else self.expression())
