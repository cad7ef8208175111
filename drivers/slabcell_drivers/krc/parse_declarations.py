"""How is a KRL declaration read?  DECL, STRUC, ENUM, SIGNAL, CHANNEL, IMPORT and EXT, in any mixture of modifiers."""

from slabcell_drivers.krc.parse_expressions import ExpressionParser
from slabcell_drivers.krc.syntax import (
    Channel,
    Declaration,
    Declarator,
    EnumDecl,
    Expr,
    External,
    Import,
    Parameter,
    Place,
    Signal,
    Statement,
    Struct,
)
from slabcell_drivers.krc.token_stream import KrlSyntaxError

__all__ = ["DeclarationParser"]

_EXTERNAL = ("EXT", "EXTP", "EXTFCT", "EXTFCTP", "EXTDEF")
_MODIFIERS = ("DECL", "GLOBAL", "CONST", "PUBLIC")


class DeclarationParser(ExpressionParser):
    """Reads declarations and parameter lists."""

    def at_declaration(self) -> bool:
        """Tell whether a declaration begins here (INTERRUPT DECL is a statement)."""
        if not self.at("NAME"):
            return False
        word, after = self.token.word, self.ahead()
        if after.kind in {"ASSIGN", "DOT"}:
            return False
        if word in {*_MODIFIERS, *_EXTERNAL, "STRUC", "ENUM", "SIGNAL", "IMPORT"} and after.kind == "NAME":
            return True
        if word == "CHANNEL" and after.kind == "COLON":
            return True
        if after.kind == "LSQB":  # INT[] X: not of the language, but told from X[1]=… by the name that follows
            return self._name_after_brackets()
        return after.kind == "NAME"

    def _name_after_brackets(self) -> bool:
        count = 2
        while self.ahead(count).kind in {"INT", "COMMA"}:
            count += 1
        return self.ahead(count).kind == "RSQB" and self.ahead(count + 1).kind == "NAME"

    def declaration(self) -> tuple[Statement, ...]:
        """Return the declarations of this line."""
        place = self.place
        modifiers: set[str] = set()
        while self.at_word(*_MODIFIERS) and self.ahead().kind == "NAME":
            modifiers.add(self.advance().word)
        is_global = bool(modifiers & {"GLOBAL", "PUBLIC"})
        word, after = self.token.word, self.ahead()
        if word == "STRUC" and after.kind == "NAME":
            return (self._struct(place, is_global=is_global),)
        if word == "ENUM" and after.kind == "NAME":
            return (self._enum(place, is_global=is_global),)
        if word == "SIGNAL" and after.kind == "NAME":
            return self._signals(place, is_global=is_global)
        if word == "CHANNEL":
            return (self._channel(place),)
        if word == "IMPORT" and after.kind == "NAME":
            return (self._import(place),)
        if word in _EXTERNAL and after.kind == "NAME":
            return (self._external(place),)
        if self.at_word("CONST"):
            self.advance()
            modifiers.add("CONST")
        return (self._variables(place, is_global=is_global, is_const="CONST" in modifiers),)

    def _variables(self, place: Place, *, is_global: bool, is_const: bool) -> Declaration:
        type_name = self.expect("NAME", "the name of a type").word
        if self.at("LSQB"):
            self.indices()
        names = [self._declarator()]
        while self.accept("COMMA"):
            names.append(self._declarator())
        return Declaration(place, type_name, tuple(names), is_global, is_const)

    def _declarator(self) -> Declarator:
        place = self.place
        name = self.expect("NAME", "a name").word
        dimensions = self.indices() if self.at("LSQB") else ()
        value: Expr | None = self.expression() if self.accept("ASSIGN") else None
        return Declarator(place, name, dimensions, value)

    def _struct(self, place: Place, *, is_global: bool) -> Struct:
        self.advance()
        name = self.expect("NAME", "the name of the structure").word
        members: list[tuple[str, Declarator]] = []
        type_name = ""
        while True:
            while self.at_word("DECL", "GLOBAL") and self.ahead().kind == "NAME":
                self.advance()
            if self.at("NAME") and self.ahead().kind == "NAME":
                type_name = self.advance().word
            if not type_name:
                raise KrlSyntaxError(self.token, "the type of a member")
            members.append((type_name, self._declarator()))
            if not self.accept("COMMA"):
                return Struct(place, name, tuple(members), is_global)

    def _enum(self, place: Place, *, is_global: bool) -> EnumDecl:
        self.advance()
        name = self.expect("NAME", "the name of the enumeration").word
        values: list[str] = []
        while True:
            token = self.advance() if self.token.kind in {"NAME", "ENUM"} else self.expect("NAME", "a name")
            values.append(token.word.lstrip("# \t"))
            if not self.accept("COMMA"):
                return EnumDecl(place, name, tuple(values), is_global)

    def _signals(self, place: Place, *, is_global: bool) -> tuple[Statement, ...]:
        self.advance()
        found: list[Statement] = []
        while True:
            name = self.expect("NAME", "the name of the signal").word
            if self.accept_word("FALSE", "TRUE"):
                found.append(Signal(place, name, None, None, is_global))
            else:
                first = self.postfix()
                last = self.postfix() if self.accept_word("TO") else None
                found.append(Signal(place, name, first, last, is_global))
            if not self.accept("COMMA"):
                return tuple(found)

    def _channel(self, place: Place) -> Channel:
        self.advance()
        self.expect("COLON", "':' and the name of the channel")
        name = self.expect("NAME", "the name of the channel").word
        self.expect("COLON", "':' and the name of the interface")
        interface = self.expect("NAME", "the name of the interface").word
        structure = None if self.at_end_of_line() else self.expression()
        return Channel(place, name, interface, structure)

    def _import(self, place: Place) -> Import:
        self.advance()
        self.accept_word("DECL")
        type_name = self.expect("NAME", "the name of a type").word
        name = self.expect("NAME", "a name").word
        if self.at("LSQB"):
            self.indices()
        self.expect_word("IS")
        path: list[str] = []
        while not self.at_end_of_line():
            path.append(self.advance().word)
        module, _, source = "".join(path).rpartition("..")
        if not module or not source:
            raise KrlSyntaxError(self.token, "/R1/MODULE..NAME")
        return Import(place, type_name, name, module.rsplit("/", maxsplit=1)[-1], source.partition("[")[0])

    def _external(self, place: Place) -> External:
        with_result = self.advance().word.startswith("EXTFCT")
        result_type = self.expect("NAME", "the type of the result").word if with_result else ""
        if with_result and self.at("LSQB"):
            self.indices()
        name = self.expect("NAME", "the name of the subprogram").word
        return External(place, name, result_type, self.parameters() if self.at("LPAR") else ())

    def parameters(self) -> tuple[Parameter, ...]:
        """Return a formal parameter list: names in DEF, types in EXT, both with dimensions and ``:IN`` or ``:OUT``."""
        self.expect("LPAR", "'('")
        found: list[Parameter] = []
        while not self.at("RPAR"):
            place = self.place
            first = self.expect("NAME", "a parameter or ')'").word
            type_name = ""
            dimensions = 0
            if self.at("NAME"):
                type_name, first = first, self.advance().word
            if self.at("LSQB"):
                dimensions = len(self.indices())
            mode = self.expect_word("IN", "OUT", "INOUT").word if self.accept("COLON") else ""
            found.append(Parameter(place, first, dimensions, mode, type_name))
            if not self.accept("COMMA"):
                break
        self.expect("RPAR", "',' or ')'")
        return tuple(found)
