"""What a controller's compiler would say of a program, before it runs."""

from pathlib import Path

import pytest

from slabcell_drivers.krc.loading import read_project
from slabcell_drivers.krc.static import check

pytestmark = pytest.mark.unit

CONFIG = b"DEFDAT $CONFIG\nINT counter\nENDDAT\n"


def found(source, name="t.src", *, data=None, config=True, **more):
    files = {name: source.encode("latin-1") if isinstance(source, str) else source}
    if data is not None:
        files["t.dat"] = f"DEFDAT t PUBLIC\n{data}\nENDDAT\n".encode()
    if config:
        files["$config.dat"] = CONFIG
    files |= {key.replace("_", "."): value.encode() for key, value in more.items()}
    return [(d.line, d.severity, d.code) for d in check(files)]


def program(body, declarations="INT i\nBOOL b\nREAL r\nCHAR t[5]\nFRAME f"):
    return f"DEF t()\n{declarations}\n{body}\nEND\n"


TYPED = "INT i,k[2]\nBOOL b\nREAL r,x[3]\nCHAR t[5]\nFRAME f\nE6AXIS ax\nEKI_STATUS ret"
TAKERS = """DEF in_int(p:IN)
INT p
END
DEF out_real(p:OUT)
REAL p
END
DEF in_text(p[]:IN)
CHAR p[]
END
DEF in_reals(p[]:OUT)
REAL p[]
END
DEF in_enum(p:IN)
MODE_OP p
END
DEF in_pose(p:IN)
E6POS p
END
"""
FIRST = 7  # the line of the first statement of `program`


def test_a_correct_program_has_no_findings():
    body = 'i=counter+1\nb=(i==3) AND NOT b\nr=i/2\nt[]="abc"\nf.X=r\nt[1]="x"\nhelp(i,r)\nBAS(#INITMOV,0)\nPTP {A1 0}'
    text = program(body) + "DEF help(a:IN,c:OUT)\nINT a\nREAL c\nc=a\nEND\n"
    assert found(text) == []


@pytest.mark.parametrize(
    ("body", "severity", "code"),
    [
        ("nothere=1", "error", "undeclared"),
        ("i=nothere", "error", "undeclared"),
        ("nothere()", "error", "undeclared"),
        ("i=STRLEN()", "error", "arguments"),
        ("BAS(#INITMOV,0,1)", "error", "arguments"),
        ("RETURN 5", "error", "return"),
        ("EXIT", "error", "exit"),
        ("GOTO away", "error", "label"),
        ("a:\na:", "error", "duplicate"),
        ("i=1\nINT late", "error", "declaration-order"),
        ("IF b THEN\nINT inner\nENDIF", "error", "declaration-order"),
        ("b=5", "error", "type"),
        ('i="abc"', "error", "type"),
        ("f=5", "error", "type"),
        ("r=#RED", "error", "type"),
        ('t[]="abcdef"', "error", "text-length"),
        ("IF i THEN\nENDIF", "error", "condition"),
        ("WHILE 1\nENDWHILE", "error", "condition"),
        ("WAIT FOR r", "error", "condition"),
        ("IF i==1 AND b THEN\nENDIF", "warning", "parentheses"),
        ("IF i==1 AND r==2 THEN\nENDIF", "warning", "parentheses"),
        ("WAIT FOR $IN[1]==TRUE AND $IN[2]==FALSE", "warning", "parentheses"),
        ("INTERRUPT DECL 50 WHEN b DO t()", "warning", "priority"),
        ("t(5)", "error", "arguments"),
        ("f.Q=1", "error", "member"),
        ("SWITCH r\nCASE 1\nENDSWITCH", "error", "switch"),
        ("SWITCH b\nCASE 1\nENDSWITCH", "error", "switch"),
        ("r=b+1", "error", "operand"),
        ("r=f*2", "error", "operand"),
        ("INTERRUPT DECL 5 WHEN STRLEN(t[])>3 DO t()", "warning", "condition-call"),
        ("SPLINE\nPTP f\nENDSPLINE", "error", "spline"),
        ("SPLINE\ni=1\nENDSPLINE", "error", "spline"),
        ("SPLINE\nSLIN f C_DIS\nENDSPLINE", "error", "spline-approximation"),
        ("SPLINE\nTRIGGER WHEN DISTANCE=0 DELAY=0 DO b=TRUE\nSPL f\nENDSPLINE", "error", "spline-trigger"),
        ("PTP_SPLINE\nSLIN f\nENDSPLINE", "error", "ptp-spline"),
        ("PTP_SPLINE\nCONST_VEL START=0\nSPTP f\nENDSPLINE", "error", "ptp-spline"),
        ("SPLINE\nTIME_BLOCK PART=50\nSPL f\nENDSPLINE", "error", "time-block"),
    ],
)
def test_a_rule_of_the_language_is_checked(body, severity, code):
    reports = found(program(body))
    assert (severity, code) in {(s, c) for _, s, c in reports}
    assert all(line >= FIRST for line, _, _ in reports)


@pytest.mark.parametrize(
    "call",
    [
        "in_int(b)",
        'in_int("text")',
        "in_int(f)",
        "out_real(i)",
        "out_real(x[])",
        "in_text(i)",
        "in_reals(x[1])",
        "in_reals(k[])",
        "in_enum(i)",
        "in_pose(ax)",
        'ret=EKI_GetInt("Ch","A/@B",r)',
        'ret=EKI_GetReal("Ch","A/@B",i)',
        'ret=EKI_GetFrame("Ch","A/B",r)',
        'ret=EKI_GetString("Ch","A/B",i)',
        'ret=EKI_Send("Ch",5)',
        "i=STRLEN(i)",
        "ax=INVERSE(f,f,i)",
        "ax=INVERSE(f,ax,r)",
        "EKI_CHECK(i,#QUIT)",
        "BAS(1,2)",
    ],
)
def test_an_argument_of_another_type_than_the_parameter_is_an_error(call):
    text = program(call, TYPED) + TAKERS
    assert found(text) == [(FIRST + 2, "error", "argument-type")]


@pytest.mark.parametrize(
    "call",
    [
        "in_int(r)",
        "in_int(5.5)",
        'in_int("A")',
        "out_real(x[1])",
        "out_real(f.X)",
        'in_text("a text")',
        'in_text("A")',
        "in_text(t[])",
        "in_reals(x[])",
        "in_enum(#T1)",
        "in_enum($MODE_OP)",
        "in_pose(f)",
        "in_pose({X 1,Y 2})",
        "in_pose($POS_ACT)",
        "in_int()",
        'ret=EKI_GetReal("Ch","A/@B",f.X)',
        'ret=EKI_SetInt("Ch","A/@B",r)',
        "ax=INVERSE(f,$AXIS_ACT,i)",
        "EKI_CHECK(ret,#QUIT,t[])",
        "BAS(#VEL_CP,i)",
    ],
)
def test_an_argument_that_the_parameter_can_take_is_none(call):
    assert [f for f in found(program(call, TYPED) + TAKERS) if f[1] == "error"] == []


def test_data_lists_of_the_system_may_stand_in_files_without_their_dollar():
    assert found("DEF t()\nEND\n", operate_dat="DEFDAT $OPERATE PUBLIC\nENDDAT\n") == []
    assert found("DEF t()\nEND\n", other_dat="DEFDAT another\nENDDAT\n") == [(1, "error", "data-name")]


def test_a_routine_may_declare_types_of_its_own():
    text = "DEF t()\nSTRUC pair REAL a, INT b\nENUM tint red,green\npair p\ntint c\np.b=2\nc=#red\nEND\n"
    assert found(text) == []


def test_names_have_24_characters_at_most_and_no_digit_first():
    assert found("DEF t()\nINT abcdefghijklmnopqrstuvwx\nEND\n") == []
    assert found("DEF t()\nINT abcdefghijklmnopqrstuvwxy\nEND\n") == [(2, "error", "name-length")]
    assert found("DEF 3d()\nEND\n", "3d.src") == [(1, "error", "name")]
    assert found("DEF t(abcdefghijklmnopqrstuvwxyz:IN)\nINT abcdefghijklmnopqrstuvwxyz\nEND\n")[0][2] == "name-length"


def test_the_first_routine_and_the_data_list_have_the_name_of_the_file():
    assert found("DEF other()\nEND\nDEF t()\nEND\n") == [(1, "error", "first-def")]
    assert found("DEFDAT other PUBLIC\nENDDAT\n", "t.dat") == [(1, "error", "data-name")]
    assert found("DEF T ( )\nEND\n") == []


def test_a_name_is_declared_once():
    assert (3, "error", "duplicate") in found("DEF t()\nINT a\nREAL a\nEND\n")
    assert found("DEF t(a:IN)\nINT a\nEND\n") == []
    assert found("DEF t()\nEND\nDEF h()\nEND\nDEF h()\nEND\n")[0][2] == "duplicate"
    assert found("DEF t()\nEND\n", data="INT a\nINT a") == [(3, "error", "duplicate")]


def test_functions_return_values_and_procedures_do_not():
    assert found("DEF t()\nEND\nDEFFCT INT f()\nRETURN\nENDFCT\n") == [(4, "error", "return")]
    assert found("DEF t()\nEND\nDEFFCT INT f()\nENDFCT\n") == [(3, "error", "return")]


def test_too_many_arguments_are_an_error_and_too_few_a_warning():
    text = "DEF t()\nh({})\nEND\nDEF h(a:IN,b:OUT)\nINT a,b\nEND\n"
    assert found(text.format("1,2,3"))[0] == (2, "error", "arguments")
    assert found(text.format("1")) == [(2, "warning", "arguments")]
    assert found(text.format("1,")) == []


def test_a_parameter_that_is_written_needs_a_variable():
    text = "DEF t()\nINT i\nh({})\nEND\nDEF h(a:OUT)\nINT a\na=1\nEND\n"
    assert found(text.format("5")) == [(3, "error", "arguments")]
    assert found(text.format("i")) == []


def test_constants_are_not_assigned():
    assert found("DEF t()\nlimit=3\nEND\n", data="CONST INT limit=2") == [(2, "error", "constant")]


def test_names_of_other_modules_count_only_where_they_are_global():
    text = "DEF t()\nshared=1\nhidden()\nEND\n"
    reports = found(
        text,
        lib_src="DEF lib()\nEND\nDEF hidden()\nEND\n",
        lib_dat="DEFDAT lib PUBLIC\nDECL GLOBAL INT shared\nENDDAT\n",
    )
    assert reports == [(3, "error", "undeclared")]


def test_without_the_configuration_file_an_unknown_name_is_a_warning_only():
    assert found("DEF t()\nx=1\nEND\n", config=False) == [(2, "warning", "undeclared")]


def test_folds_pair_up_and_files_are_latin_1():
    assert found("DEF t()\n;FOLD a\nEND\n") == [(2, "warning", "fold")]
    assert found("DEF t()\n;ENDFOLD\nEND\n") == [(2, "warning", "fold")]
    assert found("DEF t()\n; Größe\nEND\n") == []
    assert found("DEF t()\n; Größe\nEND\n".encode()) == [(1, "warning", "encoding")]


def test_syntax_errors_and_statements_outside_of_routines_are_among_the_findings():
    assert (2, "error", "syntax") in found("DEF t()\ni=\nEND\n")
    assert (1, "error", "outside") in found("i=5\nDEF t()\nEND\n")


def test_data_that_does_not_fit_its_declaration_is_a_finding():
    assert (2, "warning", "data") in found("DEF t()\nEND\n", data='CHAR c[3]="abcdef"')


def test_the_shipped_programs_are_clean():
    assert [str(d) for d in check(read_project(Path(__file__).parents[3] / "krl"))] == []
