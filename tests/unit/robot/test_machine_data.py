import pytest

from slabcell_drivers.robot.arm import KR6_R900
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.machine_data import MachineDataError, parse_machine_data

pytestmark = pytest.mark.unit


def machine_dat(**changed: str) -> str:
    """Return the machine data of a KR 6 R900 as a controller lays them out; lines of the given names replaced."""
    lines = [
        "&ACCESS RV",
        "DEFDAT  $MACHINE PUBLIC",
        "CHAR $V_R1MADA[32]",
        '$V_R1MADA[]="V8.3.230/KUKA8.3" ;VERSION',
        "INT $NUM_AX=6 ;axes",
        "FRAME $ROBROOT={X 10.0,Y 0.0,Z 500.0,A 90.0,B 0.0,C 0.0} ;robot in the world",
        "DECL FRA $RAT_MOT_AX[12] ;motor to axis",
        *(
            f"$RAT_MOT_AX[{i}]={{N {n},D {d}}}"
            for i, (n, d) in enumerate(
                [(-100, 1), (-120, 1), (-100, 1), (850, 9), (66096, 713), (520960, 8901), (0, 1)], 1
            )
        ),
        "REAL $VEL_AXIS_MA[12] ;1/min",
        *(f"$VEL_AXIS_MA[{i}]=6000.00" for i in range(1, 7)),
        "DECL CP $ACC_MA={CP 10.0000,ORI1 1000.00,ORI2 1000.00} ;path",
        "DECL CP $VEL_MA={CP 3.00000,ORI1 400.000,ORI2 400.000} ;path",
        *(f"$SOFTN_END[{i}]={v}" for i, v in enumerate([-170.0, -190.0, -120.0, -185.0, -120.0, -350.0], 1)),
        *(f"$SOFTP_END[{i}]={v}" for i, v in enumerate([170.0, 45.0, 156.0, 185.0, 120.0, 350.0], 1)),
        "CHAR $TRAFONAME[32]",
        '$TRAFONAME[]="#KR6R900 C4SR; FLR" ;32 characters',
        "DECL KINCLASS $KINCLASS=#STANDARD ;class",
        "DECL MAIN_AXIS $MAIN_AXIS=#NR",
        "DECL WRIST_AXIS $WRIST_AXIS=#ZEH",
        "FRAME $TIRORO={X 0.0,Y 0.0,Z 400.000,A 0.0,B 0.0,C 0.0} ;base",
        "FRAME $TFLWP={X 0.0,Y 0.0,Z 80.0000,A 0.0,B 0.0,C 0.0}",
        "FRAME $TX3P3={X 420.000,Y 0.0,Z 35.0000,A 0.0,B 90.0000,C 0.0}",
        "REAL $LENGTH_A=25.0000 ;A",
        "REAL $LENGTH_B=455.000 ;B",
        "E6AXIS $AXIS_HOME[5]",
        "$AXIS_HOME[1]={A1 0.0,A2 -90.0000,A3 90.0000,A4 0.0,A5 0.0,A6 0.0,E1 0.0}",
        "ENDDAT",
    ]
    kept = [line for line in lines if not any(f"${name}=" in line for name in changed)]
    return "\r\n".join([*kept[:-1], *(f"${name}={value}" for name, value in changed.items() if value), kept[-1]])


def test_a_real_layout_gives_the_arm_with_its_limits_and_speeds() -> None:
    data = parse_machine_data(machine_dat().encode("latin-1"))
    assert data.arm.name == "KR6R900 C4SR; FLR"
    assert data.arm.dimensions == KR6_R900.dimensions
    assert (data.arm.axis_min_deg, data.arm.axis_max_deg) == (KR6_R900.axis_min_deg, KR6_R900.axis_max_deg)
    assert data.arm.axis_speed_deg_s == pytest.approx(KR6_R900.axis_speed_deg_s, rel=2e-3)
    assert data.root_in_world == Frame(10.0, 0.0, 500.0, 90.0, 0.0, 0.0)
    assert data.home == (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
    assert (data.max_path_speed_m_s, data.max_turn_acceleration_deg_s2) == (3.0, 1000.0)


def test_letter_case_blanks_and_line_ends_do_not_matter() -> None:
    text = machine_dat().replace("\r\n", "\n").replace("$LENGTH_A=", "$length_a  = ").replace("{X ", "{ x  ")
    assert parse_machine_data(text.encode()).arm.dimensions == KR6_R900.dimensions


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"LENGTH_B": ""}, r"\$LENGTH_B is missing"),
        ({"LENGTH_B": "-3.0"}, r"\$LENGTH_B is -3 mm"),
        ({"LENGTH_A": "abc"}, r"\$LENGTH_A is 'abc', not a number"),
        ({"TX3P3": "{X 420.0,Z 35.0,B 0.0}"}, r"\$TX3P3\.B is 0"),
        ({"TIRORO": "{X 5.0,Z 400.0}"}, r"\$TIRORO\.X is 5"),
        ({"WRIST_AXIS": "#SRH"}, r"\$WRIST_AXIS is #SRH; only #ZEH"),
        ({"KINCLASS": "#SPECIAL"}, r"\$KINCLASS is #SPECIAL"),
        ({"SOFTP_END[2]": "-200.0"}, r"axis 2: \$SOFTN_END -190 is not below \$SOFTP_END -200"),
        ({"RAT_MOT_AX[4]": "{N 0,D 1}"}, r"axis 4: no speed from \$VEL_AXIS_MA 6000 and \$RAT_MOT_AX 0/1"),
    ],
)
def test_what_is_missing_or_another_kind_of_arm_is_named(changed: dict[str, str], problem: str) -> None:
    with pytest.raises(MachineDataError, match=problem):
        parse_machine_data(machine_dat(**changed).encode())


def test_all_problems_are_reported_at_once() -> None:
    with pytest.raises(MachineDataError) as caught:
        parse_machine_data(b"DEFDAT $MACHINE PUBLIC\nENDDAT\n")
    assert len(caught.value.problems) > 10


def test_a_huge_file_is_refused() -> None:
    with pytest.raises(MachineDataError, match="at most"):
        parse_machine_data(b" " * (5 * 1024 * 1024))
