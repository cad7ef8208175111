"""How is a KRL motion read?  PTP to SPL with circle angle, WITH, approximation and reference, and SPLINE blocks."""

from abc import abstractmethod

from slabcell_drivers.krc.parse_expressions import ExpressionParser
from slabcell_drivers.krc.syntax import Expr, Motion, Place, Spline, SplineCondition, Statement
from slabcell_drivers.krc.token_stream import KrlSyntaxError

__all__ = ["MOTIONS", "MotionParser"]

_BASIC = ("PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "SPL")
MOTIONS = frozenset({*_BASIC, *(f"{kind}_REL" for kind in _BASIC)})
_APPROXIMATIONS = ("C_PTP", "C_DIS", "C_VEL", "C_ORI", "C_SPL")


class MotionParser(ExpressionParser):
    """Reads motions and spline blocks."""

    @abstractmethod
    def block(self, *closers: str) -> tuple[Statement, ...]:
        """Return the statements up to one of these words."""

    @abstractmethod
    def close(self, opener: Place, *words: str) -> str:
        """Step over the word that closes a block."""

    def motion(self, place: Place) -> Motion:
        """Return the motion that begins here."""
        kind = self.advance().word
        points: list[Expr] = []
        angle: Expr | None = None
        if not self.accept("BANG"):  # "!" stands for a point that was never taught
            points.append(self.expression())
        while self.accept("COMMA"):
            if self.at_word("CA") and self.ahead().kind not in {"DOT", "LSQB", "COMMA"}:
                angle = self._angle()
            elif not self.accept("BANG"):
                points.append(self.expression())
        settings: tuple[tuple[Expr, Expr], ...] = ()
        approximation: list[str] = []
        reference = ""
        while not self.at_end_of_line():
            token = self.token
            if token.kind == "ENUM":
                reference = self.advance().word.lstrip("# \t")
            elif token.kind == "NAME" and token.word in _APPROXIMATIONS:
                approximation.append(self.advance().word)
            elif self.at_word("CA"):
                angle = self._angle()
            elif self.at_word("WITH"):
                settings += self._settings()
            elif not self.accept("COMMA"):
                raise KrlSyntaxError(token, "C_PTP, C_DIS, C_VEL, C_ORI, C_SPL, WITH or the end of the line")
        return Motion(place, kind, tuple(points), angle, settings, tuple(approximation), reference)

    def _angle(self) -> Expr:
        self.advance()
        self.accept("ASSIGN")
        return self.expression()

    def _settings(self) -> tuple[tuple[Expr, Expr], ...]:
        self.expect_word("WITH")
        found: list[tuple[Expr, Expr]] = []
        while True:
            target = self.postfix()
            self.expect("ASSIGN", "'='")
            found.append((target, self.expression()))
            if not self.at("COMMA") or (self.ahead().kind == "NAME" and self.ahead().word.startswith("C_")):
                return tuple(found)
            self.advance()

    def spline(self, place: Place) -> Spline:
        """Return the spline block that begins here."""
        kind = self.advance().word
        settings = self._settings() if self.at_word("WITH") else ()
        self.end_line()
        body = self.block("ENDSPLINE")
        self.close(place, "ENDSPLINE")
        approximation: list[str] = []
        while self.at_word(*_APPROXIMATIONS):
            approximation.append(self.advance().word)
        return Spline(place, kind, settings, body, tuple(approximation))

    def spline_condition(self, place: Place) -> SplineCondition:
        """Return TIME_BLOCK, CONST_VEL or STOP WHEN PATH."""
        kind = self.advance().word
        value: Expr | None = None
        on_start = False
        condition: Expr | None = None
        if kind == "STOP":
            self.expect_word("WHEN")
            verb = self.expect_word("PATH").word
        else:
            verb = self.expect_word("START", "PART", "END").word
        if self.accept("ASSIGN") or not (self.at_end_of_line() or self.at_word("ONSTART", "IF")):
            value = self.expression()
        while not self.at_end_of_line():
            if self.accept_word("ONSTART"):
                on_start = True
            elif self.accept_word("IF"):
                condition = self.expression()
            else:
                raise KrlSyntaxError(self.token, "ONSTART, IF or the end of the line")
        return SplineCondition(place, kind, verb, value, on_start, condition)
