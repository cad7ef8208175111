"""A copy of a controller runs as it lies: its folders, its inline forms old and new, its own $config.dat."""

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.krc.static import check
from slabcell_drivers.robot.arm import KR3_R540

pytestmark = pytest.mark.unit

CONFIG = """&ACCESS RVO\r
DEFDAT  $CONFIG\r
;FOLD BASISTECH GLOBALS\r
CONST INT MAX_TOOL=16\r
CONST INT MAX_BASE=32\r
DECL FRAME TOOL_DATA[MAX_TOOL]\r
TOOL_DATA[1]={X 0.0,Y 0.0,Z 120.5,A 0.0,B 0.0,C 0.0}\r
TOOL_DATA[2]={X 10.0,Y 0.0,Z 80.0,A 0.0,B 45.0,C 0.0}\r
DECL FRAME BASE_DATA[MAX_BASE]\r
BASE_DATA[1]={X 300.0,Y -50.0,Z 100.0,A 0.0,B 0.0,C 0.0}\r
DECL LOAD LOAD_DATA[MAX_TOOL]\r
LOAD_DATA[1]={M 1.5,CM {X 0.0,Y 0.0,Z 60.0,A 0.0,B 0.0,C 0.0},J {X 0.0,Y 0.0,Z 0.0}}\r
DECL E6AXIS XHOME={A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 -45.0,A6 0.0,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}\r
REAL DEF_VEL_CP=2.0\r
;ENDFOLD\r
;FOLD USER GLOBALS\r
DECL INT parts=0\r
SIGNAL doGrip $OUT[17]\r
SIGNAL diPart $IN[18]\r
ENUM RECIPE_T SMALL,LARGE\r
DECL RECIPE_T recipe=#LARGE\r
;ENDFOLD\r
ENDDAT\r
"""
MACHINE = """DEFDAT $MACHINE PUBLIC\r
CHAR $V_R1MADA[32]\r
$V_R1MADA[]="V8.3.0/KUKA8.3"\r
INT $NUM_AX=6 ;NUMBER OF AXES\r
REAL $VEL_AXIS_MA[12]\r
$VEL_AXIS_MA[1]=5320.0\r
SIGNAL $AXWORKSTATE1 FALSE\r
SIGNAL $IN_HOME1 $OUT[1002]\r
ENDDAT\r
"""
PROGRAM = """&ACCESS RVP\r
&REL 5\r
DEF Pick( )\r
;FOLD INI\r
  ;FOLD BASISTECH INI\r
    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )\r
    INTERRUPT ON 3\r
    BAS (#INITMOV,0 )\r
  ;ENDFOLD (BASISTECH INI)\r
;ENDFOLD (INI)\r
;FOLD PTP HOME  Vel= 50 % DEFAULT;%{PE}\r
$BWDSTART=FALSE\r
PDAT_ACT=PDEFAULT\r
FDAT_ACT=FHOME\r
BAS (#PTP_PARAMS,50 )\r
$H_POS=XHOME\r
PTP  XHOME\r
;ENDFOLD\r
;FOLD PTP P1 CONT Vel=100 % PDAT1 Tool[1] Base[1];%{PE}\r
PDAT_ACT=PPDAT1\r
FDAT_ACT=FP1\r
BAS(#PTP_PARAMS,100)\r
PTP XP1 C_PTP\r
;ENDFOLD\r
;FOLD LIN P2 Vel=0.25 m/s CPDAT1 Tool[1] Base[1];%{PE}\r
LDAT_ACT=LCPDAT1\r
FDAT_ACT=FP1\r
BAS(#CP_PARAMS,0.25)\r
LIN XP2\r
;ENDFOLD\r
doGrip=TRUE\r
SLIN XP1 WITH $VEL=SVEL_CP(0.5,,LCPDAT1), $TOOL=STOOL2(FP1), $BASE=SBASE(FP1.BASE_NO), $LOAD=SLOAD(FP1.TOOL_NO)\r
WAIT SEC 0\r
load=$LOAD.M\r
IF recipe==#LARGE THEN\r
parts=parts+1\r
ENDIF\r
END\r
"""
DATA = """DEFDAT Pick PUBLIC\r
EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )\r
DECL INT SUCCESS\r
REAL load=0.0\r
DECL PDAT PPDAT1={VEL 100.0,ACC 100.0,APO_DIST 50.0,APO_MODE #CPTP}\r
DECL LDAT LCPDAT1={VEL 0.25,ACC 50.0,APO_DIST 20.0,APO_FAC 50.0,ORI_TYP #VAR}\r
DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}\r
DECL E6POS XP1={X 150.0,Y 30.0,Z 250.0,A 0.0,B 90.0,C 0.0,S 6,T 50,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}\r
DECL E6POS XP2={X 150.0,Y 30.0,Z 200.0,A 0.0,B 90.0,C 0.0,S 6,T 50,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}\r
ENDDAT\r
"""
FILES = {
    "KRC/R1/System/$config.dat": CONFIG,
    "KRC/R1/Mada/$machine.dat": MACHINE,
    "KRC/R1/Program/Cell/Pick.src": PROGRAM,
    "KRC/R1/Program/Cell/Pick.dat": DATA,
    "KRC/R1/System/sps.sub": "DEF SPS ( )\r\nLOOP\r\nWAIT SEC 0.1\r\nENDLOOP\r\nEND\r\n",
}


@pytest.fixture
def sources():
    return {name: text.encode("latin-1") for name, text in FILES.items()}


def test_its_programs_run_with_its_own_tools_bases_and_data(sources):
    krc = SoftwareKrc(sources, robot=KR3_R540)
    assert [str(d) for d in krc.diagnostics] == []
    result = krc.run("Pick", max_wall_s=60)
    assert (result.status, result.message) == ("done", "")
    assert krc.output(17)
    assert krc.data("$CONFIG", "parts") == 1
    assert krc.data("Pick", "load") == 1.5
    assert krc.tcp.as_tuple()[:3] == pytest.approx((450, -20, 350), abs=1e-4)


def test_the_compilers_check_finds_nothing_in_it(sources):
    assert [str(d) for d in check(sources)] == []


def test_its_data_lists_are_kept_under_their_own_names(sources):
    krc = SoftwareKrc(sources, robot=KR3_R540)
    krc.run("Pick", max_wall_s=60)
    kept = krc.data_files()
    assert set(kept) == {name for name in FILES if name.endswith(".dat")}
    assert b"parts=1\r\n" in kept["KRC/R1/System/$config.dat"]
    assert kept["KRC/R1/Mada/$machine.dat"] == sources["KRC/R1/Mada/$machine.dat"]


CP_FORM = (
    "$VEL=SVEL_CP(0.2, , LCPDAT1), $TOOL=STOOL2(FP1), $BASE=SBASE(FP1.BASE_NO), $IPO_MODE=SIPO_MODE(FP1.IPO_FRAME), "
    "$LOAD=SLOAD(FP1.TOOL_NO), $ACC=SACC_CP(LCPDAT1), $ORI_TYPE=SORI_TYP(LCPDAT1), $APO=SAPO(LCPDAT1), "
    "$JERK=SJERK(LCPDAT1), $COLLMON_TOL_PRO[1]=USE_CM_PRO_VALUES(0)"
)
FORMS = f"""DEF Forms ( )\r
BAS(#INITMOV,0)\r
SPTP XHOME WITH $VEL_AXIS[1]=SVEL_JOINT(50.0), $TOOL=STOOL2(FHOME), $BASE=SBASE(FHOME.BASE_NO), \
$IPO_MODE=SIPO_MODE(FHOME.IPO_FRAME), $LOAD=SLOAD(FHOME.TOOL_NO), $ACC_AXIS[1]=SACC_JOINT(PDEFAULT), \
$APO=SAPO_PTP(PDEFAULT), $GEAR_JERK[1]=SGEAR_JERK(PDEFAULT), $COLLMON_TOL_PRO[1]=USE_CM_PRO_VALUES(0)\r
SET_CD_PARAMS (0)\r
SPTP {{A5 30}}\r
SLIN XP1 WITH {CP_FORM} C_SPL\r
SCIRC XP2, XP3 WITH $CIRC_TYPE=SCIRC_TYP(LCPDAT1), $CIRC_MODE=SCIRC_M(LCPDAT1), {CP_FORM}\r
END\r
"""
FORM_DATA = """DEFDAT Forms PUBLIC\r
DECL E6POS XP1={X 350,Y 0,Z 400,A 0,B 0,C 180}\r
DECL E6POS XP2={X 300,Y 50,Z 400,A 0,B 0,C 180}\r
DECL E6POS XP3={X 250,Y 0,Z 400,A 0,B 0,C 180}\r
DECL FDAT FP1={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE,POINT2[] " "}\r
DECL LDAT LCPDAT1={VEL 2.0,ACC 100.0,APO_DIST 10.0,APO_FAC 50.0,ORI_TYP #VAR,CIRC_TYP #BASE,JERK_FAC 50.0}\r
ENDDAT\r
"""


def test_inline_forms_of_splines_run_without_the_files_of_the_controller():
    sources = {"Forms.src": FORMS.encode(), "Forms.dat": FORM_DATA.encode()}
    krc = SoftwareKrc(sources, robot=KR3_R540)
    krc.assign("TOOL_DATA[1]={Z 50}")
    assert krc.diagnostics == []
    result = krc.run("Forms", max_wall_s=60)
    assert (result.status, result.message) == ("done", "")
    tcp = krc.tcp.as_tuple()
    assert tcp[:3] == pytest.approx((250.0, 0.0, 400.0), abs=1e-3)
    assert [
        d for d in check({"Forms.src": FORMS.encode(), "Forms.dat": FORM_DATA.encode()}) if d.severity == "error"
    ] == []
