"""How is a KRL expression read?  Precedence climbing, from the geometric operator down to the comparisons.

KRL binds comparisons weakest of all: ``a==b AND c`` is ``a==(b AND c)``.  Operators of one rank associate to the left.
"""

from slabcell_drivers.krc.syntax import (
    Aggregate,
    Binary,
    Call,
    EnumValue,
    Expr,
    Index,
    Literal,
    Member,
    Name,
    Unary,
)
from slabcell_drivers.krc.token_stream import KrlSyntaxError, TokenStream

__all__ = ["ExpressionParser"]

_GEOMETRIC = 7
_RANK_OF_WORD = {"OR": 2, "B_OR": 2, "EXOR": 3, "B_EXOR": 3, "AND": 4, "B_AND": 4}
_RANK_OF_SIGN = {"+": 5, "-": 5, "*": 6, "/": 6}
_MAX_DEPTH = 48
_MAX_OPERATORS = 150
_MAX_PARTS = 60


class ExpressionParser(TokenStream):
    """Reads expressions, aggregates, argument and index lists."""

    depth = 0

    def expression(self, lowest: int = 1) -> Expr:
        """Return the expression that begins here.  Raises KrlSyntaxError."""
        left = self._unary()
        operators = 0
        while True:
            token = self.token
            rank = 0
            if token.kind == "RELATION":
                rank = 1
            elif token.kind == "ARITHMETIC":
                rank = _RANK_OF_SIGN[token.text]
            elif token.kind == "NAME":
                rank = _RANK_OF_WORD.get(token.word, 0)
            elif token.kind == "COLON" and not self._at_mode_mark():
                rank = _GEOMETRIC
            if rank < lowest or not rank:
                return left
            operators += 1
            if operators > _MAX_OPERATORS:
                raise KrlSyntaxError(token, f"at most {_MAX_OPERATORS} operators of one rank in a row")
            place = self.place
            self.advance()
            left = Binary(place, token.word, left, self.expression(rank + 1))

    def _at_mode_mark(self) -> bool:
        """Tell whether the colon here begins ``:IN`` or ``:OUT``, or ends a line (a label)."""
        after = self.ahead()
        return after.kind == "NEWLINE" or (
            after.kind == "NAME" and after.word in {"IN", "OUT"} and self.ahead(2).kind in {"COMMA", "RPAR"}
        )

    def _unary(self) -> Expr:
        place, token = self.place, self.token
        if (token.kind == "ARITHMETIC" and token.text in "+-") or (
            token.kind == "NAME" and token.word in {"NOT", "B_NOT"}
        ):
            self._descend()
            self.advance()
            # Only the geometric operator binds more tightly to the operand of a sign than the sign itself.
            operand = self._unary()
            self.depth -= 1
            if isinstance(operand, Literal) and not isinstance(operand.value, bool | str) and token.text in "+-":
                return Literal(place, -operand.value if token.text == "-" else operand.value)
            return Unary(place, token.word, operand)
        return self.postfix()

    def _descend(self) -> None:
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            self.depth = 0
            raise KrlSyntaxError(self.token, f"at most {_MAX_DEPTH} levels of nesting")

    def postfix(self) -> Expr:
        """Return a primary with its indices, members and arguments."""
        place = self.place
        result = self._primary()
        for _ in range(_MAX_PARTS):
            if self.at("LSQB"):
                result = Index(place, result, self.indices())
            elif self.at("DOT"):
                self.advance()
                result = Member(place, result, self.expect("NAME", "the name of a member").word)
            elif self.at("LPAR") and isinstance(result, Name):
                result = Call(place, result.name, self.arguments())
            else:
                return result
        raise KrlSyntaxError(self.token, f"at most {_MAX_PARTS} indices and members in a row")

    def _primary(self) -> Expr:
        place, token = self.place, self.token
        match token.kind:
            case "NAME":
                self.advance()
                if token.word in {"TRUE", "FALSE"}:
                    return Literal(place, token.word == "TRUE")
                return Name(place, token.word)
            case "INT":
                self.advance()
                return Literal(place, int(token.text))
            case "REAL":
                self.advance()
                # 1.#INF and its kin are what a controller saves of a number that is none
                return Literal(place, 0.0 if "#" in token.text else float(token.text))
            case "BITS":
                self.advance()
                digits = token.text[2:-1].replace(" ", "")
                base = 16 if token.text[1] in "Hh" else 2
                try:
                    return Literal(place, int(digits or "0", base))
                except ValueError:
                    raise KrlSyntaxError(token, "binary digits") from None
            case "STRING":
                self.advance()
                return Literal(place, token.text[1:-1])
            case "ENUM":
                self.advance()
                return EnumValue(place, token.word[1:].strip())
            case "LPAR":
                self._descend()
                self.advance()
                inner = self.expression()
                self.expect("RPAR", "')'")
                self.depth -= 1
                if isinstance(inner, Binary):
                    return Binary(inner.place, inner.operator, inner.left, inner.right, parenthesized=True)
                return inner
            case "LBRACE":
                return self.aggregate()
            case "COLON":  # the name of a channel: COPEN(:SER_1,…)
                self.advance()
                return Name(place, ":" + self.expect("NAME", "the name of a channel").word)
            case _:
                raise KrlSyntaxError(token, "an expression")

    def indices(self) -> tuple[Expr | None, ...]:
        """Return what stands between square brackets; an empty place is None."""
        self.expect("LSQB", "'['")
        self._descend()
        found: list[Expr | None] = []
        while True:
            found.append(None if self.token.kind in {"COMMA", "RSQB"} else self.expression())
            if not self.accept("COMMA"):
                break
        self.expect("RSQB", "',' or ']'")
        self.depth -= 1
        return tuple(found)

    def arguments(self) -> tuple[Expr | None, ...]:
        """Return the arguments of a call; one left out is None."""
        self.expect("LPAR", "'('")
        self._descend()
        found: list[Expr | None] = []
        if not self.at("RPAR"):
            while True:
                found.append(None if self.token.kind in {"COMMA", "RPAR"} else self.expression())
                if self.at("COLON"):
                    self.advance()
                    self.expect_word("IN", "OUT")
                if not self.accept("COMMA"):
                    break
        self.expect("RPAR", "',' or ')'")
        self.depth -= 1
        return tuple(found)

    def aggregate(self) -> Aggregate:
        """Return the aggregate that begins here."""
        place = self.place
        self.expect("LBRACE", "'{'")
        self._descend()
        type_name = ""
        if self.at("NAME") and self.ahead().kind == "COLON":
            type_name = self.advance().word
            self.advance()
        members: list[tuple[str, Expr]] = []
        while not self.at("RBRACE"):
            members.append(self._aggregate_member())
            if not self.accept("COMMA"):
                break
        self.expect("RBRACE", "',' or '}'")
        self.depth -= 1
        return Aggregate(place, type_name, tuple(members))

    def _aggregate_member(self) -> tuple[str, Expr]:
        token = self.token
        if token.kind != "NAME" or token.word in {"TRUE", "FALSE", "NOT", "B_NOT"}:
            return "", self.expression()
        start = self.index
        name = self.advance().word
        if self.at("LSQB"):
            indices = self.indices()
            if indices != (None,):
                numbers = [str(i.value) if isinstance(i, Literal) else "" for i in indices]
                name += f"[{','.join(numbers)}]"
        if self.token.kind in {"COMMA", "RBRACE", "DOT", "RELATION", "COLON"} or self.at_word(*_RANK_OF_WORD):
            self.index = start
            return "", self.expression()
        return name, self.expression()
