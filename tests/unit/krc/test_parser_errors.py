"""What the parser says of wrong programs: where, what was expected, and everything in one run."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.krc.parser import parse
from slabcell_drivers.krc.static import check
from slabcell_drivers.krc.syntax import Assign, Binary, Literal, Name, Unary
from slabcell_drivers.robot.arm import KR3_R540

pytestmark = pytest.mark.unit


def found(text):
    return [(d.line, d.column, d.message) for d in parse(text, "x.src").diagnostics]


@pytest.mark.parametrize(
    ("line", "column", "expected"),
    [
        ("x==5", 2, "'=' or '('"),
        ("x=", 3, "an expression"),
        ("x=5 6", 5, "the end of the line"),
        ("x=(5", 5, "')'"),
        ("x[1=5", 4, "',' or ']'"),
        ("IF x\nENDIF", 5, "THEN"),
        ("FOR i=1 10\nENDFOR", 9, "TO"),
        ("WAIT 5", 6, "FOR or SEC"),
        ("INTERRUPT 5", 11, "DECL or ON or OFF or ENABLE or DISABLE"),
        ("TRIGGER WHEN TIME=5 DO x=1", 14, "DISTANCE or PATH"),
        ("PTP P1 FAST", 8, "C_PTP"),
        ("LIN P1 C_DIST", 8, "C_PTP, C_DIS"),
        ("SLIN P1 WITH $VEL.CP=1 C_X", 24, "C_PTP, C_DIS"),
        ("5=x", 1, "a statement"),
        ("HALT 5", 6, "the end of the line"),
        ("x={A 1,B}, 2", 10, "the end of the line"),
        ("DECL INT 5", 10, "a name"),
        ("GOTO 5", 6, "a label"),
        ('t[]="abc', 5, 'no closing "'),
        ("x='B12'", 3, "binary digits"),
    ],
)
def test_an_error_names_line_column_and_what_was_expected(line, column, expected):
    ((row, at, message),) = found(f"DEF x()\n{line}\nEND\n")
    assert (row, at) == (2, column)
    assert expected in message


def test_all_errors_are_reported_and_the_good_lines_between_them_kept():
    text = "DEF x()\na=\nb=1\nc=(\nd=2\nIF e\nf=3\nENDIF\nEND\nDEF y()\ng=]\nEND\n"
    module = parse(text, "x.src")
    assert [d.line for d in module.diagnostics] == [2, 4, 6, 11]
    assert [r.name for r in module.routines] == ["X", "Y"]


@pytest.mark.parametrize(
    ("text", "opener", "word"),
    [
        ("DEF x()\nIF a THEN\nb=1\nEND\n", 2, "ENDIF"),
        ("DEF x()\nLOOP\nb=1\nEND\n", 2, "ENDLOOP"),
        ("DEF x()\nWHILE a\nFOR i=1 TO 2\nENDWHILE\nEND\n", 3, "ENDFOR"),
        ("DEF x()\nSWITCH a\nCASE 1\nb=1\nEND\n", 2, "ENDSWITCH"),
        ("DEF x()\nREPEAT\nEND\n", 2, "UNTIL"),
        ("DEF x()\na=1\n", 1, "END"),
        ("DEFFCT INT x()\nRETURN 1\n", 1, "ENDFCT"),
        ("DEFDAT x\nINT a\n", 1, "ENDDAT"),
    ],
)
def test_a_block_that_is_never_closed_is_named_by_its_first_line(text, opener, word):
    ((line, _, message),) = found(text)
    assert line == opener
    assert word in message


def test_a_word_that_closes_nothing_is_an_error_of_its_line():
    assert [line for line, _, _ in found("DEF x()\nENDIF\na=1\nENDLOOP\nEND\n")] == [2, 4]


def test_nesting_without_end_is_refused_in_words():
    deep = "(" * 5000 + "1" + ")" * 5000
    assert "levels of nesting" in found(f"DEF x()\na={deep}\nEND\n")[0][2]
    blocks = "IF a THEN\n" * 300 + "ENDIF\n" * 300
    assert any("blocks within each other" in m for _, _, m in found(f"DEF x()\n{blocks}END\n"))


def test_a_huge_file_is_refused_by_its_size():
    (problem,) = parse(b" " * (32 * 1024 * 1024 + 1), "x.src").diagnostics
    assert problem.code == "too-large"


def test_operators_bind_as_the_language_ranks_them():
    body = parse("DEF x()\nr=NOT a==b AND c OR d EXOR e\ns=1+2*a:b\nt=-a*b-c\nEND\n", "x.src").routines[0].body
    (first, second, third) = (s.value for s in body if isinstance(s, Assign))
    # comparisons are weakest: (NOT a) == ((b AND c) OR (d EXOR e))
    assert isinstance(first, Binary)
    assert first.operator == "=="
    assert isinstance(first.left, Unary)
    assert first.right.operator == "OR"
    assert first.right.left.operator == "AND"
    assert first.right.right.operator == "EXOR"
    assert second.operator == "+"
    assert second.right.operator == "*"
    assert second.right.right.operator == ":"
    assert third.operator == "-"
    assert third.left.operator == "*"
    assert isinstance(third.left.left, Unary)
    assert third.right == Name(third.right.place, "C")


def test_a_sign_before_a_number_is_part_of_it():
    (statement,) = parse("DEF x()\nr=-5.5\nEND\n", "x.src").routines[0].body
    assert isinstance(statement.value, Literal)
    assert statement.value.value == -5.5


WORDS = [
    "DEF x()",
    "END",
    "IF a THEN",
    "ENDIF",
    "x=5",
    "LOOP",
    "ENDLOOP",
    "PTP P1",
    "{",
    "[",
    "(",
    '"',
    ":",
    "CASE 1",
    "=",
]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(WORDS), max_size=30), st.sampled_from(["\n", " ", ""]))
def test_any_order_of_words_ends_in_a_module(words, separator):
    assert parse(separator.join(words), "x.src").file == "x.src"


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_end_in_a_module(source):
    assert parse(source, "x.src").file == "x.src"


def test_a_program_cut_off_anywhere_never_ends_the_parser():
    text = "DEF x(a:IN)\nINT a\nIF (a==1) THEN\nPTP {A1 5,A2 -3} C_PTP\nELSE\nx[3]=f(a,,b)\nENDIF\nEND\n"
    for position in range(len(text)):
        assert parse(text[:position], "x.src").file == "x.src"


@pytest.mark.parametrize(
    "expression",
    ["+".join(["1"] * 5000), "a" + ".b" * 5000, "a" + "[1]" * 5000, "-" * 5000 + "1", "{X " * 500 + "1" + "}" * 500],
)
def test_an_expression_without_end_is_refused_in_words_and_checked_without_harm(expression):
    source = f"DEF x()\nr={expression}\nEND\n".encode()
    assert any("at most" in message for _, _, message in found(source.decode()))
    assert any(d.code == "syntax" for d in check({"x.src": source}))


@pytest.mark.parametrize("expression", ["+".join(["1"] * 150), "a" + ".b" * 59, "(" * 40 + "1" + ")" * 40])
def test_an_expression_at_the_limit_is_read_checked_and_compiled(expression):
    source = f"DEF x()\nINT r\nr={expression}\nEND\n".encode()
    assert found(source.decode()) == []
    assert all(d.code != "syntax" for d in check({"x.src": source}))
    assert SoftwareKrc({"x.src": source}, robot=KR3_R540).run("x", max_wall_s=60).status in {"done", "error"}
