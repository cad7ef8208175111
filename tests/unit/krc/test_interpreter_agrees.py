"""Random expressions and blocks: the interpreter agrees with a second reading of them in Python."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.robot.arm import KR3_R540

pytestmark = pytest.mark.unit

VALUES = {"a": 7, "b": -3, "c": 100}


def quotient(x, y):
    return abs(x) // abs(y) * (1 if (x < 0) == (y < 0) else -1)


def combined(children):
    return st.tuples(st.sampled_from(["+", "-", "*", "/"]), children, children)


NUMBERS = st.recursive(st.one_of(st.integers(-50, 50), st.sampled_from(sorted(VALUES))), combined, max_leaves=8)


def text(tree):
    if isinstance(tree, tuple):
        return f"({text(tree[1])}{tree[0]}{text(tree[2])})"
    return str(tree)


def value(tree):
    if isinstance(tree, str):
        return VALUES[tree]
    if isinstance(tree, int):
        return tree
    operator, left, right = tree[0], value(tree[1]), value(tree[2])
    match operator:
        case "+":
            return left + right
        case "-":
            return left - right
        case "*":
            return left * right
        case _:
            return quotient(left, right)


def controller(body):
    data = "".join(f"INT {name}={number}\n" for name, number in VALUES.items())
    return SoftwareKrc(
        {"t.src": f"DEF t()\n{body}\nEND\n".encode(), "t.dat": f"DEFDAT t\n{data}INT r=0\nINT n=0\nENDDAT\n".encode()},
        robot=KR3_R540,
    )


@settings(max_examples=60, deadline=None)
@given(NUMBERS)
def test_integer_arithmetic_is_that_of_a_controller(tree):
    krc = controller(f"r={text(tree)}")
    result = krc.run("t", max_wall_s=60)
    try:
        expected = value(tree)
    except ZeroDivisionError:
        assert result.message_number == 91002
        return
    if -(2**31) <= expected < 2**31:
        assert krc.data("t", "r") == expected
    else:
        assert result.message_number == 91003


CONDITIONS = st.recursive(
    st.tuples(st.sampled_from(["<", ">", "==", "<>", "<=", ">="]), st.integers(-3, 3), st.integers(-3, 3)),
    lambda inner: st.tuples(st.sampled_from(["AND", "OR", "EXOR"]), inner, inner),
    max_leaves=6,
)


def truth(tree):
    operator, left, right = tree
    if isinstance(left, tuple):
        a, b = truth(left), truth(right)
        return {"AND": a and b, "OR": a or b, "EXOR": a != b}[operator]
    return {
        "<": left < right,
        ">": left > right,
        "==": left == right,
        "<>": left != right,
        "<=": left <= right,
        ">=": left >= right,
    }[operator]


def condition_text(tree):
    operator, left, right = tree
    if isinstance(left, tuple):
        return f"({condition_text(left)} {operator} {condition_text(right)})"
    return f"({left}{operator}{right})"


@settings(max_examples=60, deadline=None)
@given(CONDITIONS)
def test_conditions_choose_the_branch_they_should(tree):
    krc = controller(f"IF {condition_text(tree)} THEN\nr=1\nELSE\nr=2\nENDIF")
    assert krc.run("t", max_wall_s=60).status == "done"
    assert krc.data("t", "r") == (1 if truth(tree) else 2)


@settings(max_examples=40, deadline=None)
@given(st.integers(-6, 6), st.integers(-6, 6), st.integers(-3, 3).filter(bool))
def test_counting_loops_turn_as_often_as_they_should(start, end, step):
    krc = controller(f"FOR r={start} TO {end} STEP {step}\nn=n+1\nENDFOR")
    assert krc.run("t", max_wall_s=60).status == "done"
    assert krc.data("t", "n") == len(range(start, end + (1 if step > 0 else -1), step))
