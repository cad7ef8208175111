"""The exact bytes: what a KRC sent and what the cell must answer, kept so that no change to them goes unnoticed."""

import pytest

from slabcell_drivers.robot.eki.codec import decode_request, encode_answer, encode_request
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import AckState, Answer, Offer, Request, RequestType, ResultCode, RobotStatus

pytestmark = pytest.mark.unit

HELLO = (
    b'<Robot><Head Ver="1" Ses="0" Seq="7" Type="1"></Head><Job Id="0" Model="0"></Job>'
    b'<Pose X="-140.000000" Y="-242.487122" Z="290.000000" A="-120.000000" B="0.000000" C="180.000000"></Pose>'
    b'<Axis A1="120.000000" A2="-90.000000" A3="90.000000" A4="0.000000" A5="90.000000" A6="0.000000"></Axis>'
    b'<Ack ResId="105" State="2"></Ack><Stat Mode="1" Tool="1" Base="1" Grip="1" Err="0"></Stat>'
    b'<Check Ints="120"></Check></Robot>'
)
ANSWERS = [
    (
        Answer(
            3, 1, 7, left=1, trigger_sequence=4, offer=Offer(105, 1, 4, Frame(1.5, -2, 10), Frame(44, 25, 10), 0.99)
        ),
        (
            b'<Vis><Head Ver="1" Ses="3" Seq="1" Ack="7"></Head>'
            b'<Res Code="0" ResId="105" Idx="1" Left="1" TrigSeq="4"></Res>'
            b'<Pick X="1.500" Y="-2.000" Z="10.000" A="0.000" B="0.000" C="0.000"></Pick>'
            b'<Place X="44.000" Y="25.000" Z="10.000" A="0.000" B="0.000" C="0.000"></Place>'
            b'<Part Slot="4" Score="0.990" Grip="0"></Part><Check Ints="127" Reals="89.490"></Check><Msg>-</Msg></Vis>'
        ),
    ),
    (
        Answer(3, 2, 8, code=1101, message="1101 Camera does not answer. Check its cable & power."),
        (
            b'<Vis><Head Ver="1" Ses="3" Seq="2" Ack="8"></Head>'
            b'<Res Code="1101" ResId="0" Idx="0" Left="0" TrigSeq="0"></Res>'
            b'<Pick X="0.000" Y="0.000" Z="0.000" A="0.000" B="0.000" C="0.000"></Pick>'
            b'<Place X="0.000" Y="0.000" Z="0.000" A="0.000" B="0.000" C="0.000"></Place>'
            b'<Part Slot="0" Score="0.000" Grip="0"></Part><Check Ints="1115" Reals="0.000"></Check>'
            b"<Msg>1101 Camera does not answer. Check its cable &amp; power.</Msg></Vis>"
        ),
    ),
    (
        Answer(3, 3, 9, code=ResultCode.JOB_COMPLETE),
        (
            b'<Vis><Head Ver="1" Ses="3" Seq="3" Ack="9"></Head>'
            b'<Res Code="1" ResId="0" Idx="0" Left="0" TrigSeq="0"></Res>'
            b'<Pick X="0.000" Y="0.000" Z="0.000" A="0.000" B="0.000" C="0.000"></Pick>'
            b'<Place X="0.000" Y="0.000" Z="0.000" A="0.000" B="0.000" C="0.000"></Place>'
            b'<Part Slot="0" Score="0.000" Grip="0"></Part><Check Ints="17" Reals="0.000"></Check><Msg>-</Msg></Vis>'
        ),
    ),
]


def test_a_controllers_hello_is_understood():
    assert decode_request(HELLO) == Request(
        RequestType.HELLO,
        0,
        7,
        tcp=Frame(-140.0, -242.487122, 290.0, -120.0, 0.0, 180.0),
        axes_deg=(120.0, -90.0, 90.0, 0.0, 90.0, 0.0),
        ack_result_id=105,
        ack_state=AckState.GRASPED,
        status=RobotStatus(mode=1, tool=1, base=1, gripper_holds_part=True),
    )


@pytest.mark.parametrize(("answer", "expected"), ANSWERS)
def test_answers_are_these_bytes(answer, expected):
    assert encode_answer(answer) == expected


def test_what_we_write_for_a_robot_reads_like_what_a_controller_writes():
    request = decode_request(HELLO)
    assert decode_request(encode_request(request)).ack_result_id == request.ack_result_id
    assert encode_request(request).startswith(b'<Robot><Head Ver="1" Ses="0" Seq="7" Type="1"></Head>')
