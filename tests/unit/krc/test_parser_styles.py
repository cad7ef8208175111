"""KRL as different houses write it: every one of these texts is parsed without a word."""

import pytest

from slabcell_drivers.krc.parser import parse

pytestmark = pytest.mark.unit


def problems(text, file="x.src"):
    source = text.encode("latin-1") if isinstance(text, str) else text
    return [str(d) for d in parse(source, file).diagnostics]


OLD_KRC2 = """&ACCESS RVP
&REL 27
&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe
&PARAM EDITMASK = *
DEF Palette ( )
;FOLD INI
  ;FOLD BASISTECH INI
    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
    INTERRUPT ON 3
    BAS (#INITMOV,0 )
  ;ENDFOLD (BASISTECH INI)
  ;FOLD USER INI
    ;Make your modifications here

  ;ENDFOLD (USER INI)
;ENDFOLD (INI)

;FOLD PTP HOME  Vel= 100 % DEFAULT;%{PE}%MKUKATPBASIS,%CMOVE,%VPTP,%P 1:PTP, 2:HOME, 3:, 5:100, 7:DEFAULT
$BWDSTART = FALSE
PDAT_ACT=PDEFAULT
FDAT_ACT=FHOME
BAS (#PTP_PARAMS,100 )
$H_POS=XHOME
PTP  XHOME
;ENDFOLD
;FOLD LIN P1 CONT Vel= 0.5 m/s CPDAT1 Tool[1]:Sauger Base[2]:Tisch;%{PE}%R 5.4.38
$BWDSTART=FALSE
LDAT_ACT=LCPDAT1
FDAT_ACT=FP1
BAS(#CP_PARAMS,0.5)
LIN XP1 C_DIS C_DIS
;ENDFOLD
PTP XP2 C_PTP C_DIS
CIRC XP3,XP4 C_DIS
CIRC XP3 , XP4 , CA 270.5 C_ORI
END ;(Palette)
"""

SPTP_LINE = (
    "SPTP XHOME WITH $VEL_AXIS[1] = SVEL_JOINT(100.0), $TOOL = STOOL2(FHOME), $BASE = SBASE(FHOME.BASE_NO), "
    "$IPO_MODE = SIPO_MODE(FHOME.IPO_FRAME), $LOAD = SLOAD(FHOME.TOOL_NO), $ACC_AXIS[1] = SACC_JOINT(PDEFAULT), "
    "$APO = SAPO_PTP(PDEFAULT), $GEAR_JERK[1] = SGEAR_JERK(PDEFAULT), $COLLMON_TOL_PRO[1] = USE_CM_PRO_VALUES(0) C_Spl"
)
INLINE_FORMS = """&ACCESS RVP
&COMMENT Größenprüfung mit Umlauten
DEF  Spline_forms( )
DECL INT i
  DECL REAL  weg ; after a blank line and a comment

  ; still a declaration
  BOOL ok
;FOLD SPTP HOME Vel=100 % DEFAULT ;%{PE}
{SPTP_LINE}
;ENDFOLD
SLIN XP1 WITH $VEL = SVEL_CP(2.0, , LCPDAT1), $TOOL = STOOL2(FP1), $ORI_TYPE = SORI_TYP(LCPDAT1) C_SPL
SCIRC XP2, XP3 , CA 90 WITH $VEL.CP = 0.25
SPTP_REL {A1 10}
SLIN_REL {X 10, Y -5.5} WITH $BASE=$NULLFRAME #TOOL
SPLINE WITH $VEL.CP=0.4, $ACC.CP=1.5
  TIME_BLOCK START
  SPL XP4
  TIME_BLOCK PART = 30
  SPL XP5 WITH $VEL.CP=0.2
  TIME_BLOCK PART 70
  SLIN XP6
  TIME_BLOCK END = 4.5
  CONST_VEL START = 10 ONSTART
  SCIRC XP7,XP8
  CONST_VEL END = -5
  TRIGGER WHEN PATH = 0 ONSTART DELAY = 10 DO $OUT[5] = TRUE
  STOP WHEN PATH = -20 IF $IN[17]==FALSE
  SPL XP9
ENDSPLINE C_SPL
PTP_SPLINE WITH $VEL_AXIS[1]=50
 SPTP XP1
 SPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}
ENDSPLINE
PTP !
LIN XP1 : {X 0,Y 0,Z -100,A 0,B 0,C 0} C_VEL
LIN_REL {Z 100} C_DIS #BASE
END
""".replace("{SPTP_LINE}", SPTP_LINE)

VENDOR_SAMPLE = """&ACCESS RVO
DEF SensorDemo( )
DECL EKI_STATUS RET
DECL INT n,k,code
DECL FRAME found[10]
CHAR answer[128]
RET=EKI_Init("Sensor")
RET=EKI_Open("Sensor")
EKI_CHECK(RET,#QUIT,"Sensor")
wait for $FLAG[1]
RET=EKI_SetFrame("Sensor","req/args/robot_pose",$POS_ACT_MES:INV_POS($TOOL))
RET = EKI_ClearBuffer("Sensor", "res")
$FLAG[998]=FALSE
$TIMER[1]=-5000
$TIMER_STOP[1]=FALSE
WAIT SEC 0 ; Force synchronization
RET=EKI_Send("Sensor","req")
WAIT FOR $FLAG[998] OR NOT $FLAG[997] OR $TIMER_FLAG[1]
RET=EKI_CheckBuffer("Sensor","res/poses/le/pose")
n=RET.Buff
FOR k=1 TO n
  found[k]=$NULLFRAME
  RET=EKI_GetFrame("Sensor","res/poses/le/pose",found[k])
ENDFOR
RET=EKI_GetString("Sensor","res/message",answer[])
RET=EKI_GetInt("Sensor","res/return_code/@value",code)
MsgQuit("no grasp: %1","Sensor",code)
MsgNotify(answer[],"Sensor", , "abc")
END
"""

DATA_LIST = """&ACCESS RV
&REL 3
DEFDAT  SENSORDEMO PUBLIC
;FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS,%CEXT,%VCOMMON,%P
;FOLD BASISTECH EXT;%{PE}%MKUKATPBASIS,%CEXT,%VEXT,%P
EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )
EXTFCT REAL D_SCALE(REAL :IN, INT :OUT)
EXTP  DELETE_BUFFER ( )
EXTFCTP  INT SET_DATA(CHAR OWNER[16] :IN,CHAR AXIS[5] :IN,REAL VALUE :IN)
EXTFCTP  BOOL STRTOREAL(CHAR STRVAR[256] :IN,REAL RETVAL :OUT)
EXT IR_STOPM ( )
DECL INT SUCCESS
;ENDFOLD (BASISTECH EXT)
;ENDFOLD (EXTERNAL DECLARATIONS)
GLOBAL STRUC RESULT_T INT ID,REAL SCORE,FRAME POSE,CHAR TXT[80],BOOL OK
STRUC STATE_X CMD_STAT RET1,INT MSG_NO,INT HITS,INT LENGTH
GLOBAL ENUM COLOUR_T RED,GREEN,BLUE
ENUM DAY MON, TUE , WED
SIGNAL DI_OK $IN[5]
SIGNAL DO_NUMBER $OUT[10] TO $OUT[17]
SIGNAL $AXWORKSTATE1 FALSE
SIGNAL AI_FORCE $ANIN[1]
DECL GLOBAL CONST INT LIMIT=24
GLOBAL CONST DECL REAL PI2=6.2831853
CONST INT SMALL=-1
DECL GLOBAL COLOUR_T LAMP=#GREEN
DECL RESULT_T RES[LIMIT]
DECL E6POS XP1={X 500.123,Y -20.0,Z 30,A 0.0,B 90.0,C -180.0,S 2,T 10,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}
DECL LDAT LCPDAT1={VEL 2.00000,ACC 100.000,APO_DIST 100.000,APO_FAC 50.0000,ORI_TYP #VAR}
DECL LOAD LD={M 1.5,CM {X 0.0,Y 0.0,Z 60.0,A 0.0,B 0.0,C 0.0},J {X 0.1,Y 0.1,Z 0.1}}
DECL FRAME F={FRAME: X 1,Y 2}
CHAR NAMES[3,24]
NAMES[1,]="first"
NAMES[2,]=" "
INT A=1,B=2,C
INT GRID[3,4,2]
GRID[1,2,1]=5
BOOL FLAGS[2]
FLAGS[1]=TRUE
FLAGS[2]=FALSE
INT MASK='HFF',BITS='B1010',EXPONENT=3
REAL SMALLER=1.0E-5,LARGER=.5,WHOLE=5.
IMPORT INT COUNTER IS /R1/OTHER..COUNTER
CHANNEL :CH_1 :CH_1 $CHSTRUCT
ENDDAT
"""

MACHINE_DATA = """&ACCESS
DEFDAT  $MACHINE PUBLIC
CHAR $V_R1MADA[32]
$V_R1MADA[]="V8.3.0/KUKA8.3"
INT $TECH_MAX=6    ;MAX. ANZAHL FUNKTIONSGENERATOREN
INT $NUM_AX=6
DECL FRA $RAT_MOT_AX[12]
$RAT_MOT_AX[1]={N -1752,D 9}
$RAT_MOT_AX[2]={N 1752,D 9}
REAL $VEL_AXIS_MA[12]
$VEL_AXIS_MA[1]=5320.0
DECL EX_KIN $EX_KIN={ET1 #NONE,ET2 #NONE,ET3 #NONE,ET4 #NONE,ET5 #NONE,ET6 #NONE}
$DYN_DAT[250]=0.0
$EKO_DAT[ 1 ] = 1.5E+3
$X[1,2]=3.0
DECL FRAME $TIRORO={X 0.0,Y 0.0,Z 345.0,A 0.0,B 0.0,C 0.0}
BOOL $BOUNCE_TIME=FALSE
ENDDAT
"""

CONTROL_FLOW = """DEF flow(a:IN,b :OUT , c[]:IN, d[,]:OUT)
DECL INT a,b
CHAR c[]
REAL d[,]
INTERRUPT DECL 21 WHEN $IN[1]==FALSE DO stopit(a,TRUE)
GLOBAL INTERRUPT DECL 4 WHEN ($TIMER_FLAG[2]) DO x=5
INTERRUPT ON
interrupt on 21
INTERRUPT OFF 21
INTERRUPT DISABLE 4
Interrupt Enable
loop1:
IF (a > 3) AND NOT (b<=2) THEN
  GOTO loop1
ELSE
  If a==1 Then
    b=1
  EndIf
ENDIF
SWITCH a
  CASE 1,2,-3
    b=1
  CASE 4
  DEFAULT
    b=2
ENDSWITCH
SWITCH  c[1]

  ; a comment before the first case
  CASE "A"
    b=1
  CASE "B","C"
    EXIT
ENDSWITCH
FOR a=1 TO 10 STEP 2
ENDFOR
FOR a = 10 TO 1 STEP -1
  b = b + a
ENDFOR
WHILE TRUE
  EXIT
ENDWHILE
REPEAT
  b=b-1
UNTIL b<0
LOOP
  WAIT FOR $IN[1]
  WAIT FOR NOT $IN[1] AND ($IN[2] OR $IN[3])
  WAIT SEC 0.5
  WAIT SEC (b/10.0)
  CONTINUE
  $OUT[3]=TRUE
  PULSE($OUT[4],TRUE,0.2)
  PULSE ( $OUT[4] , FALSE , b )
  HALT
ENDLOOP
TRIGGER WHEN DISTANCE=0 DELAY=20 DO $OUT[5]=TRUE
TRIGGER WHEN DISTANCE=1 DELAY=-20 DO signalit(a) PRIO=-1
TRIGGER WHEN PATH=-50.5 DELAY=0 DO signalit(1,2) PRIO = 25
BRAKE
BRAKE F
RESUME
ON_ERROR_PROCEED
b=$POS_ACT.X
CONFIRM 0
CONFIRM $MESS
sub(a,,b)
sub(,)
sub( )
$CYCFLAG[1]=$IN[1] AND NOT $IN[2]
x=$DATE.SEC
y=s.TO.STEP
c[]="text"
c[3]="x"
names[2,]="abc"
err=ERR_RAISE($ERR)
ASYPTP {E1 100}
ASYSTOP $ASYNC_AXIS
ANIN ON force=1.0*AI_1+0.5
ANIN OFF force
ANOUT ON speed=0.8*$VEL_ACT-1.0 DELAY=-0.1 MINIMUM=0.1 MAXIMUM=1
ANOUT OFF speed
DIGIN ON x = 1.0 * $DIGIN1
COPEN(:CH_1,handle)
CREAD(handle,stat,mode,timeout,offset,"%s",c[])
CWRITE($CMD,STAT,MODE,"STOP 0")
SWRITE(c[],stat,offset,"%d %3.2f %s",a,r,c[])
CAST_TO(buffer[],offset,a,b)
RETURN
END
GLOBAL DEFFCT REAL half(v:IN)
REAL v
RETURN (v/2.0)
ENDFCT
DEFFCT CHAR[24] nameof(i:IN)
INT i
RETURN names[i,]
ENDFCT
DEFFCT INT[] list()
RETURN 1
ENDFCT
DEFFCT BOOL even(n:IN)
INT n
RETURN n B_AND 1 == 0
ENDFCT
"""


STYLES = {
    "krc2 with inline folds": OLD_KRC2,
    "spline inline forms": INLINE_FORMS,
    "vendor sample": VENDOR_SAMPLE,
    "data list": DATA_LIST,
    "machine data": MACHINE_DATA,
    "control flow": CONTROL_FLOW,
}


@pytest.mark.parametrize("style", STYLES)
def test_a_house_style_parses_without_a_word(style):
    assert problems(STYLES[style]) == []


@pytest.mark.parametrize("style", STYLES)
def test_line_ends_letter_case_and_blanks_make_no_difference(style):
    text = STYLES[style]
    crlf = text.replace("\n", "\r\n")
    assert problems(crlf) == []
    assert problems(crlf.lower()) == []
    assert problems(crlf.replace(" ", "\t ")) == []
    assert problems(text.encode()) == []
    assert problems(b"\xef\xbb\xbf" + text.encode()) == []


@pytest.mark.parametrize(
    "line",
    [
        "$OUT [ 3 ] = TRUE",
        "X={E6AXIS: A1 0,A2 -90}",
        "X={X 1,Y {A 1,B 2},Z -h}",
        "X={}",
        "X={1,2,3}",
        "X={a+1,b[2],c.d}",
        'X={NAME[] "abc",N[2] 5,M[1,2] 6}',
        "X=a:b:{Z 5}",
        "X=-a*-b",
        "X=NOT(a)",
        "X=B_NOT 'HFF' B_AND mask",
        "X=f(g(1,h()),{X 1},a[1,2])",
        "X=a.b[3].c",
        "X=(((1)))",
        "X=1.5E+3 - .25 + 7.",
        "X=#RED",
        "X = # RED",
        "X=f ( :IN_1 )",
        "WAIT FOR(TRUE)",
        "IF a[1]==b THEN\nENDIF",
        "STEP=5",
        "TO[1]=5",
        "PATH.X=3",
        "LIN.X=3",
        "WAIT=3",
        "END.X=3",
        "label: x=3",
        "PTP P1:P2 C_PTP",
        "PTP F(1) C_DIS",
        "CIRC P1,P2,CA=200.0 C_DIS",
        "SIGNAL a $IN[1],b $OUT[2] TO $OUT[4]",
        "DECL GLOBAL E6POS P[3]",
        "EXT foo(INT:IN)",
        "RETURN",
        "END:\nGOTO END",
        "INTERRUPT DECL 5 WHEN x DO HALT",
        "TRIGGER WHEN DISTANCE=0 DELAY=0 DO BRAKE",
        "DECL REAL broken=-1.#IND",
        "x=1.#INF",
        "  &PARAM in the middle",
        'SYNCCMD(#PROGSYNC,"x",1)',
        "LIN_REL {Y 15}#TOOL",
        "PTP_REL{A4 -0.5}",
        "FOR k=(1) TO (n) STEP (2)\nENDFOR",
        "IF(a)THEN\nb=NOT  b\nENDIF",
        "IF (a<> NOT (b)) THEN\nENDIF",
        "SWITCH($ERR.NUMBER)\nCASE 4,8\nDEFAULT\nENDSWITCH",
        "a[k].low =  -1E10 ;(lowest)",
        "$OUT[first*(-1)]=TRUE",
        "ready =true; ((a==FALSE) AND (b==TRUE))",
        'MsgDialog(n, "which", "module", "x", "One",, , , ,,)',
        "CHANNEL :SER_9 :SER_9 $PSER_9",
        "DECL EXT_MOD_T M={O_FILE[] \" \",OPTION 'B0000'}",
        "WAIT FoR Done (h) OR TRUE",
        "share=a/100.",
        "f=EK(M[k].ROOT,M[k].KIND,a:B[n]:c)",
        "$CYCFLAG[n]=((a>b)OR(c>d))AND e",
        'DECL BASIS_SUGG_T LAST={POINT1[] "P1",CONT[] "C_DIS C_DIS",N 1}',
    ],
)
def test_a_line_that_somebody_writes_is_taken(line):
    assert problems(f"DEF x()\n{line}\nEND\n") == []


def test_subprograms_nested_in_folds_and_files_without_a_last_line_end_are_taken():
    text = "DEF a()\nEND\n;FOLD more\nGLOBAL DEF b()\nEND\n;ENDFOLD\nDEFFCT INT c()\nRETURN 1\nENDFCT"
    module = parse(text, "a.src")
    assert module.diagnostics == ()
    assert [r.name for r in module.routines] == ["A", "B", "C"]
    assert [r.is_global for r in module.routines] == [False, True, False]


def test_comments_behind_the_last_line_of_a_routine_and_spaces_in_its_first_are_taken():
    text = 'Global DEF  a (x : IN , y[] :OUT)\nEND; (a)\nDEFFCT  CHAR [8] b( )\nRETURN "b"\nENDFCT ;(b)\n'
    module = parse("DEF $M_A( )\nEND\n" + text, "$m_a.src")
    assert module.diagnostics == ()
    assert [r.name for r in module.routines] == ["$M_A", "A", "B"]


def test_a_submit_program_is_a_program():
    text = "&ACCESS RVP\nDEF  SPS ( )\n;FOLD DECLARATIONS\nDECL INT n\n;ENDFOLD\nLOOP\nUSER()\nENDLOOP\nEND\n"
    assert problems(text, "sps.sub") == []


def test_letters_of_latin_1_stay_what_they_are():
    module = parse('DEF x()\nt[]="Größe"\nEND\n'.encode("latin-1"), "x.src")
    assert module.routines[0].body[0].value.value == "Größe"


def test_odd_names_of_programs_are_read_for_the_check_to_complain_about():
    assert [r.name for r in parse("DEF 3D_Test( )\nEND\n", "3d_test.src").routines] == ["3D_TEST"]
    assert parse("DEFDAT A-B PUBLIC\nENDDAT\n", "a-b.dat").data.name == "A-B"
