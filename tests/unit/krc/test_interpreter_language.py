"""What KRL programs compute: values, scopes, calls and the functions of the controller."""

import random

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.krc.kernel import BUILTINS
from slabcell_drivers.krc.messages import MotionMessage, RunMessage
from slabcell_drivers.robot.arm import KR3_R540

pytestmark = pytest.mark.unit


def run(body, declarations="", *, more="", data="", files=None, **options):
    """Run a program made of these lines; return result and controller, whose module T has the variables of ``data``."""
    sources = {
        "t.src": f"DEF t()\n{declarations}\n{body}\nEND\n{more}\n".encode("latin-1"),
        "t.dat": f"DEFDAT t PUBLIC\n{data}\nENDDAT\n".encode("latin-1"),
        **(files or {}),
    }
    krc = SoftwareKrc(sources, robot=KR3_R540, **options)
    assert [str(d) for d in krc.diagnostics] == []
    return krc.run("t", max_wall_s=60), krc


def value_of(expression, type_name="REAL", declarations="", **options):
    result, krc = run(f"r={expression}", declarations, data=f"DECL {type_name} r", **options)
    assert result.status == "done", result
    return krc.data("t", "r")


@pytest.mark.parametrize(
    ("expression", "type_name", "value"),
    [
        ("7/2", "INT", 3),
        ("-7/2", "INT", -3),
        ("7/2.0", "REAL", 3.5),
        ("7.5", "INT", 8),
        ("-7.5", "INT", -8),
        ("7.4", "INT", 7),
        ("2+3*4", "INT", 14),
        ("(2+3)*4", "INT", 20),
        ("-2*-3", "INT", 6),
        ("'HFF' B_AND 'B1111'", "INT", 15),
        ("'HF0' B_OR 5", "INT", 245),
        ("B_NOT 0", "INT", -1),
        ("'HFFFFFFFF'", "INT", -1),
        ("6 B_EXOR 3", "INT", 5),
        ("1==1.0", "BOOL", True),
        ("NOT (1>2) AND (3<=3)", "BOOL", True),
        ("TRUE EXOR TRUE", "BOOL", False),
        ("#RED==#RED", "BOOL", True),
        ("#RED<>#GREEN", "BOOL", True),
        ('"A"', "CHAR", "A"),
        ("66", "CHAR", "B"),
        ('"A"=="A"', "BOOL", True),
        ('"A"', "INT", 65),
        ("ABS(-3.5)", "REAL", 3.5),
        ("SQRT(16)", "REAL", 4.0),
        ("SIN(30)", "REAL", pytest.approx(0.5)),
        ("COS(60)", "REAL", pytest.approx(0.5)),
        ("TAN(45)", "REAL", pytest.approx(1.0)),
        ("ACOS(0)", "REAL", pytest.approx(90.0)),
        ("ATAN2(1,1)", "REAL", pytest.approx(45.0)),
        ("ATAN2(-1,0)", "REAL", pytest.approx(-90.0)),
        ("0.1", "REAL", pytest.approx(0.1, abs=1e-8)),
    ],
)
def test_an_expression_has_the_value_the_language_gives_it(expression, type_name, value):
    assert value_of(expression, type_name) == value


def test_reals_have_32_bits():
    assert value_of("16777217.0") == 16777216.0
    assert value_of("0.1") != 0.1


def test_comparisons_bind_weakest_and_are_read_as_meant_where_that_cannot_be():
    assert value_of("TRUE == FALSE AND FALSE", "BOOL") is False  # TRUE == (FALSE AND FALSE)
    assert value_of("5 == 5 AND 6 == 6", "BOOL") is True  # 5 == (5 AND 6) == 6 could not be computed
    assert value_of("5 == 4 OR 6 == 6", "BOOL") is True
    assert value_of("NOT TRUE OR 1 < 2", "BOOL") is True


@pytest.mark.parametrize(
    ("body", "number", "text"),
    [
        ("r=1/0", 91002, "division by 0"),
        ("r=TRUE", 1446, "TRUE does not fit into REAL"),
        ("n=2000000000*2", 91003, "too large"),
        ("r=u", 1422, "U value invalid"),
        ("r=f.X", 1422, "F.X value invalid"),
        ("n=a[4]", 1444, "index 4 is outside of 1 to 3"),
        ("a[0]=1", 1444, "index 0 is outside of 1 to 3"),
        ("nothere=1", 91005, "NOTHERE is not declared"),
        ("nothere(1)", 91005, "NOTHERE() is not declared"),
        ('t[]="abcdef"', 1446, "longer than the CHAR array of 5"),
        ("f.Q=1", 91005, "FRAME has no member Q"),
        ("r=SQRT(-1)", 91008, "below 0"),
        ("$IN[1]=TRUE", 1388, "write-protected"),
        ("$OUT[9000]=TRUE", 1444, "not in 1 to 8192"),
        ("$ANOUT[1]=1.5", 1446, "not in -1 to 1"),
        ("IF 5 THEN\nENDIF", 91004, "no BOOL"),
        ("r=BAS(#INITMOV,0)+1", 91004, "no number"),
        ("GOTO away", 91005, "label AWAY"),
        ("EXIT", 91020, "EXIT stands in no loop"),
        ("deep()", 1424, "calls within each other"),
        ("fixed=2", 1388, "constant"),
        ("whole(TRUE)", 2275, "argument 1 (X) takes INT, not BOOL"),
        ("whole($ERR)", 2275, "argument 1 (X) takes INT, not ERROR_T"),
        ("whole($UNHEARD[1])", 2275, "WHOLE(X): TRUE does not fit into INT"),
        ("fill(n)", 2275, "argument 1 (X) writes REAL, not INT"),
        ("n=STRLEN(n)", 2275, "argument 1 takes CHAR[], not INT"),
    ],
)
def test_an_error_stops_the_program_with_number_text_and_line(body, number, text):
    more = "DEF deep()\ndeep()\nEND\nDEF whole(x:IN)\nINT x\nEND\nDEF fill(x:OUT)\nREAL x\nEND"
    body = f"$UNHEARD[1]=TRUE\n{body}"
    declarations = "INT n\nREAL r,u\nFRAME f\nINT a[3]\nCHAR t[5]"
    result, krc = run(body, declarations, more=more, data="DECL CONST INT fixed=1")
    assert (result.status, result.message_number) == ("error", number)
    assert text in result.message
    assert result.file == "t.src"
    assert result.line >= 7
    assert krc.messages[-1].number == number


def test_every_loop_ends_where_it_should():
    body = """n=0
FOR i=1 TO 3
 n=n+i
ENDFOR
FOR i=10 TO 1 STEP -4
 n=n+100
ENDFOR
FOR i=5 TO 1
 n=n+10000
ENDFOR
WHILE n<400
 n=n+50
ENDWHILE
REPEAT
 n=n+1
UNTIL n>=410
LOOP
 n=n+1
 IF n==420 THEN
  EXIT
 ENDIF
ENDLOOP
again:
n=n+1
IF n<425 THEN
 GOTO again
ENDIF"""
    _, krc = run(body, "INT i", data="INT n")
    assert krc.data("t", "n") == 425


@pytest.mark.parametrize(("subject", "value"), [("1", 10), ("3", 20), ("9", 30), ("#B", 40), ('"x"', 50)])
def test_switch_takes_the_first_case_that_fits_or_the_default(subject, value):
    cases = {"#B": "CASE #A\nn=1\nCASE #B,#C\nn=40", '"x"': 'CASE "x"\nn=50'}
    body = (
        f"SWITCH {subject}\n{cases.get(subject, 'CASE 1' + chr(10) + 'n=10' + chr(10) + 'CASE 2,3' + chr(10) + 'n=20')}"
    )
    _, krc = run(f"{body}\nDEFAULT\nn=30\nENDSWITCH", data="INT n")
    assert krc.data("t", "n") == value


def test_parameters_go_in_by_value_and_out_by_reference_also_to_elements_and_members():
    more = """DEF change(a:IN,b:OUT,c:OUT,t[]:OUT,f:OUT)
INT a,b
REAL c
CHAR t[]
FRAME f
a=a+1
b=a
c=2.5
t[]="out"
f.X=7
END"""
    _, krc = run(
        "change(n,arr[2],p.Z,txt[],p)", data="INT n=5\nINT arr[3]\nFRAME p={X 1,Y 2,Z 3}\nCHAR txt[10]", more=more
    )
    assert krc.data("t", "n") == 5
    assert krc.data("t", "arr")[1] == 6
    assert krc.data("t", "txt") == "out"
    assert krc.data("t", "p").z_mm == 2.5
    assert krc.data("t", "p").x_mm == 7


def test_arguments_left_out_have_no_value():
    more = "DEF tell(a:IN,b:IN,c:IN)\nINT a,b,c\nn=a+c\nON_ERROR_PROCEED\nn=b\nIF $ERR.NUMBER==1422 THEN\nn=n+100\n"
    more += "ENDIF\nEND"
    _, krc = run("tell(1,,2)", data="INT n", more=more)
    assert krc.data("t", "n") == 103


def test_functions_call_each_other_within_expressions():
    more = """DEFFCT INT fac(n:IN)
INT n
IF n<2 THEN
RETURN 1
ENDIF
RETURN n*fac(n-1)
ENDFCT
DEFFCT FRAME shifted(f:IN,d:IN)
FRAME f
REAL d
f.Z=f.Z+d
RETURN f
ENDFCT
DEFFCT CHAR[10] hello()
RETURN "hello"
ENDFCT"""
    _, krc = run(
        "n=fac(fac(3))+fac(2)*fac(2)\nf=shifted({X 1,Y 2,Z 3,A 0,B 0,C 0},fac(3))\nt[]=hello()",
        data="INT n\nFRAME f\nCHAR t[10]",
        more=more,
    )
    assert krc.data("t", "n") == 724
    assert krc.data("t", "f").z_mm == 9
    assert krc.data("t", "t") == "hello"


def test_a_function_without_return_value_is_an_error():
    result, _ = run("n=f()", data="INT n", more="DEFFCT INT f()\nENDFCT")
    assert result.message_number == 91010


def test_structures_are_copied_when_stored_and_passed():
    body = "a.X=1\nb=a\na.X=2\narr[1]=a\na.X=3\ns.F=a\na.X=4"
    _, krc = run(body, data="FRAME a={X 0,Y 0,Z 0,A 0,B 0,C 0}\nFRAME b\nFRAME arr[2]\nSTRUC S_T FRAME F,INT N\nS_T s")
    assert krc.data("t", "b").x_mm == 1
    assert krc.data("t", "arr")[0].x_mm == 2
    assert krc.data("t", "s")["F"].x_mm == 3


def test_positions_take_each_others_members():
    body = "f=p\nq=f\np2=$NULLFRAME"
    data = "E6POS p={X 1,Y 2,Z 3,A 4,B 5,C 6,S 2,T 10}\nFRAME f\nPOS q\nE6POS p2"
    _, krc = run(body, data=data)
    assert krc.data("t", "f").as_tuple() == (1, 2, 3, 4, 5, 6)
    assert krc.data("t", "q") == {"X": 1, "Y": 2, "Z": 3, "A": 4, "B": 5, "C": 6}
    assert krc.data("t", "p2")["X"] == 0


def test_the_geometric_operator_multiplies_frames():
    _, krc = run("f=a:{X 10,Y 0,Z 0,A 0,B 0,C 0}:{Z -5}", data="FRAME a={X 1,Y 2,Z 3,A 90,B 0,C 0}\nFRAME f")
    assert krc.data("t", "f").as_tuple() == pytest.approx((1, 12, -2, 90, 0, 0), abs=1e-5)


def test_aggregates_of_types_defined_by_the_program():
    data = """STRUC POINT_T INT ID,FRAME POSE,CHAR NAME[8],COLOUR_T COL,INT ROW[2]
ENUM COLOUR_T RED,GREEN
DECL POINT_T p={ID 3,POSE {X 1,Y 2,Z 3,A 0,B 0,C 0},NAME[] "abc",COL #GREEN,ROW[2] 9}"""
    result, krc = run('p.ID=p.ID+1\np.NAME[2]="X"\np.COL=#RED\np.POSE.Z=p.POSE.X', data=data)
    assert result.status == "done"
    assert krc.data("t", "p.ID") == 4
    assert krc.data("t", "p.NAME[]") == "aXc"
    assert krc.data("t", "p.COL") == "#RED"
    assert krc.data("t", "p.POSE.Z") == 1
    assert krc.data("t", "p.ROW[2]") == 9
    assert run("p.COL=#BLUE", data=data)[0].message_number == 1446


def test_arrays_of_three_dimensions_and_of_texts():
    data = 'INT g[2,3,4]\nCHAR names[3,8]\nnames[2,]="two"\nCHAR c'
    _, krc = run('g[2,3,4]=24\ng[1,1,1]=g[2,3,4]+1\nnames[1,]="one"\nc=names[2,3]\nnames[2,1]="T"', data=data)
    assert krc.data("t", "g[1,1,1]") == 25
    assert krc.data("t", "names[1,]") == "one"
    assert krc.data("t", "names[2,]") == "Two"
    assert krc.data("t", "c") == "o"


@pytest.mark.parametrize(
    ("body", "name", "value"),
    [
        ('n=STRLEN("abc")', "n", 3),
        ("n=STRDECLLEN(t[])", "n", 20),
        ('t[]="ab"\nn=STRADD(t[],"cd")', "t", "abcd"),
        ('t[]="ab"\nb=STRCLEAR(t[])', "t", ""),
        ('b=STRCOMP("aB","Ab",#NOT_CASE_SENS)', "b", True),
        ('b=STRCOMP("aB","Ab",#CASE_SENS)', "b", False),
        ('b=STRCOPY(t[],"copied")', "t", "copied"),
        ('n=STRFIND(1,"hello","l",#CASE_SENS)', "n", 3),
        ('n=STRFIND(4,"hello","l",#CASE_SENS)', "n", 4),
        ('n=STRFIND(1,"hello","z",#CASE_SENS)', "n", 0),
        ('b=STRTOINT("  42",n)', "n", 42),
        ('b=STRTOINT("4x",n)', "b", False),
        ('b=STRTOREAL("1.5E1",r)', "r", 15.0),
        ('b=STRTOBOOL("TRUE",b)', "b", True),
        ('b=STRTOFRAME("{X 1,Y 2,Z 3,A 0,B 0,C 0}",f)', "f.Y", 2),
        ('o=0\nSWRITE(t[],st,o,"%d|%5.2f|%s|%c",3,1.5,"ab","c")', "t", "3| 1.50|ab|c"),
        ('o=0\nSWRITE(t[],st,o,"a")\nSWRITE(t[],st,o,"%03d",7)', "t", "a007"),
        ('t[]="12 3.5 xy"\no=0\nSREAD(t[],st,o,"%d %f",n,r)', "r", 3.5),
        ('n=-1\nIF VARSTATE("n")==#INITIALIZED THEN\nn=5\nENDIF', "n", 5),
        ('n=0\nIF VARSTATE("r")==#DECLARED THEN\nn=6\nENDIF', "n", 6),
        ('n=0\nIF VARSTATE("nothing")==#UNKNOWN THEN\nn=7\nENDIF', "n", 7),
    ],
)
def test_functions_on_texts_and_variables(body, name, value):
    data = "INT n\nINT o\nREAL r\nBOOL b\nFRAME f\nCHAR t[20]\nDECL STATE_T st"
    result, krc = run(body, data=data)
    assert result.status == "done", result
    assert krc.data("t", name) == value


def test_on_error_proceed_lets_one_statement_fail():
    body = "ON_ERROR_PROCEED\nr=u\nn=$ERR.NUMBER\nline=$ERR.LINE_NR\nERR_CLEAR($ERR)\nm=$ERR.NUMBER\nr=u"
    result, krc = run(body, "REAL u", data="REAL r\nINT n,m,line")
    assert krc.data("t", "n") == 1422
    assert krc.data("t", "line") == 4
    assert krc.data("t", "m") == 0
    assert (result.status, result.line) == ("error", 9)


def test_err_raise_raises_again_what_was_kept():
    result, _ = run("ON_ERROR_PROCEED\nr=u\nERR_RAISE($ERR)", "REAL u", data="REAL r")
    assert (result.status, result.message_number) == ("error", 1422)
    assert "U value invalid" in result.message


def test_on_error_proceed_reaches_into_the_routine_that_the_statement_calls():
    _, krc = run(
        "ON_ERROR_PROCEED\nfails()\nn=n+$ERR.NUMBER", data="INT n=0", more="DEF fails()\nREAL u\nn=1\nn=u\nEND"
    )
    assert krc.data("t", "n") == 1423


def test_signals_are_names_of_inputs_and_outputs():
    data = "SIGNAL lamp $OUT[7]\nSIGNAL word $OUT[11] TO $OUT[14]\nSIGNAL sensor $IN[2]"
    _, krc = run("lamp=TRUE\nword=5\nn=word*2", data=data + "\nINT n")
    assert krc.output(7)
    assert [krc.output(i) for i in range(11, 15)] == [True, False, True, False]
    assert krc.data("t", "n") == 10


def test_global_data_and_routines_are_seen_from_other_modules_and_local_ones_are_not():
    files = {
        "lib.src": b"DEF lib()\nEND\nGLOBAL DEF give(x:OUT)\nINT x\nx=shared+hidden\nhelper(x)\nEND\n"
        b"DEF helper(x:OUT)\nINT x\nx=x+1\nEND\n",
        "lib.dat": b"DEFDAT lib PUBLIC\nDECL GLOBAL INT shared=40\nINT hidden=1\nENDDAT\n",
        "R1/System/$config.dat": b"DEFDAT $CONFIG\nINT everywhere=1000\nENDDAT\n",
    }
    result, krc = run("give(n)\nn=n+shared+everywhere", data="INT n", files=files)
    assert result.status == "done"
    assert krc.data("t", "n") == 1082
    assert run("helper(n)", data="INT n", files=files)[0].message_number == 91005


def test_a_routine_of_another_file_is_called_by_the_name_of_the_file():
    files = {"other.src": b"DEF other(x:OUT)\nINT x\nx=9\nEND\n"}
    _, krc = run("other(n)", data="INT n", files=files)
    assert krc.data("t", "n") == 9


def test_data_lists_may_use_constants_of_others_as_sizes():
    files = {"$config.dat": b"DEFDAT $CONFIG\nCONST INT MANY=4\nINT row[MANY]\nENDDAT\n"}
    _, krc = run("FOR i=1 TO MANY\nrow[i]=i*i\nENDFOR\nn=row[MANY]", "INT i", data="INT n", files=files)
    assert krc.data("t", "n") == 16


def test_data_keeps_its_value_from_run_to_run_and_locals_do_not():
    result, krc = run("n=n+1\nl=l+1", "INT l", data="INT n=0")
    assert result.message_number == 1422
    assert krc.run("t", max_wall_s=60).message_number == 1422
    assert krc.data("t", "n") == 2


def test_data_is_set_and_read_from_outside():
    _, krc = run("n=1", data="INT n\nFRAME f\nCHAR t[5]\nINT a[3]\nDECL E6AXIS ax")
    krc.set_data("t", "f", {"X": 1, "Y": 2, "Z": 3, "A": 0, "B": 0, "C": 0})
    krc.set_data("t", "t[]", "abc")
    krc.set_data("t", "a[2]", 7)
    krc.set_data("t", "ax.A3", 90)
    assert krc.data("t", "f").y_mm == 2
    assert krc.data("t", "t") == "abc"
    assert krc.data("t", "a") == [None, 7, None]
    assert krc.data("t", "ax") == {"A3": 90}
    assert krc.data("", "TOOL_DATA[3]") is None


def test_messages_show_their_parameters():
    body = """msg={MODUL[] "cell",NR 17,MSG_TXT[] "part %1 of %2 at %3"}
par[1]={PAR_TYPE #VALUE,PAR_INT 3}
par[2]={PAR_TYPE #VALUE,PAR_TXT[] "twelve"}
par[3]={PAR_TYPE #VALUE,PAR_REAL 1.5}
opt={VL_STOP FALSE,CLEAR_P_RESET TRUE,CLEAR_P_SAW FALSE,LOG_TO_DB FALSE}
h=SET_KRLMSG(#STATE,msg,par[],opt)
b=EXISTS_KRLMSG(h)
b=CLEAR_KRLMSG(h)
IF EXISTS_KRLMSG(h) THEN
HALT
ENDIF
MsgNotify("hello %1","mod",5,,44)"""
    declarations = "DECL KRLMSG_T msg\nDECL KRLMSGPAR_T par[3]\nDECL KRLMSGOPT_T opt\nINT h\nBOOL b"
    result, krc = run(body, declarations)
    assert result.status == "done"
    assert [str(m) for m in krc.messages] == ["STATE cell 17: part 3 of twelve at 1.5", "NOTIFY mod 44: hello 5"]


def test_a_dialog_waits_for_its_answer():
    asked = []

    def answer(message):
        asked.append(message.softkeys)
        return 2 if len(asked) > 3 else 0

    result, krc = run('MsgDialog(n,"go on?","cell",,"YES","NO")', data="INT n", dialog=answer)
    assert result.status == "done"
    assert krc.data("t", "n") == 2
    assert asked[0] == ("", "", "", "", "", "NO", "YES")  # the first text stands on softkey 7


def test_two_texts_or_a_number_fill_a_notification():
    body = 'MsgNotifyTextPar("%1 and %2","cell",0,"cup","hose",44)\nMsgNotifyTextPar("%1 left",,3)'
    assert [str(m) for m in run(body)[1].messages] == ["NOTIFY cell 44: cup and hose", "NOTIFY  0: 3 left"]


def test_what_a_message_has_no_words_for_stays_as_the_controller_words_it():
    result, krc = run("n=a[4]", "INT n\nINT a[3]")
    assert result.message == "Array index inadmissible: A[4]: index 4 is outside of 1 to 3"
    assert krc.messages[-1].text.startswith(result.message)


def test_the_position_is_not_known_before_a_tool_is():
    result, krc = run("n=$ERR.NUMBER\nON_ERROR_PROCEED\np=$POS_ACT\nn=$ERR.NUMBER", data="E6POS p\nINT n")
    assert (result.status, krc.data("t", "n")) == ("done", 1419)
    assert value_of('VARSTATE("$POS_ACT")==#DECLARED', "BOOL") is True
    assert run("$TOOL=$NULLFRAME\np=$POS_ACT", data="E6POS p")[0].status == "done"


def test_a_quit_message_holds_the_program_until_it_is_acknowledged():
    result, krc = run('MsgQuit("check the gripper","cell")')
    assert result.status == "done"
    assert result.virtual_time_s >= 1.0
    assert krc.messages[0].kind == "QUIT"


def test_values_are_packed_into_a_buffer_and_come_out_again():
    body = """o=0
CAST_TO(buffer[],o,n,r,b,c,t[])
size=o
o=0
CAST_FROM(buffer[],o,n2,r2,b2,c2,t2[])"""
    data = """CHAR buffer[60]
INT n=-70000,n2=0,o,size
REAL r=1.5,r2=0.0
BOOL b=TRUE,b2=FALSE
CHAR c="x",c2=" "
CHAR t[4]="ab"
CHAR t2[4]=" "
"""
    result, krc = run(body, data=data)
    assert result.status == "done", result
    assert krc.data("t", "size") == 4 + 4 + 1 + 1 + 4
    assert [krc.data("t", name) for name in ("n2", "r2", "b2", "c2", "t2")] == [-70000, 1.5, True, "x", "ab"]


def test_a_cyclic_flag_takes_no_function():
    more = "DEFFCT BOOL f()\nRETURN TRUE\nENDFCT"
    assert run("$CYCFLAG[1]=f()", more=more)[0].message_number == 1608


def test_types_that_a_project_declares_take_the_place_of_the_built_in_ones():
    files = {
        "R1/operate.dat": b"DEFDAT $OPERATE PUBLIC\nSTRUC CIRC_MODE INT AUX,TARGET\nENUM LOAD HEAVY,LIGHT\nENDDAT\n"
    }
    _, krc = run("m.AUX=3\nl=#LIGHT", data="CIRC_MODE m\nLOAD l", files=files)
    assert krc.data("t", "m") == {"AUX": 3}
    assert krc.data("t", "l") == "#LIGHT"


ODD = ["1", "-1.5", "TRUE", '"x"', '"text"', "#RED", "f", "n", "a[]", "t[]", "u", "{X 1}", "ax"]


@pytest.mark.parametrize("name", sorted(BUILTINS))
def test_a_function_given_anything_returns_or_stops_with_a_message(name):
    """Whatever a program hands to a function of the controller, Python's own errors do not come through."""
    builtin = BUILTINS[name]
    chance = random.Random(name)
    declarations = "INT n\nREAL u\nFRAME f\nINT a[3]\nCHAR t[9]\nE6AXIS ax\n"
    for _ in range(6):
        count = chance.randint(builtin.least, min(builtin.most, builtin.least + 3))
        call = f"{name}({','.join(chance.choice([*ODD, '']) for _ in range(count))})"
        result, _ = run(f"n=1\nf=$NULLFRAME\n{call}", declarations, dialog=lambda message: 1)
        assert result.status in {"done", "error"}, (call, result)
        assert result.status == "done" or result.message_number in {*RunMessage, *MotionMessage}, (call, result)
