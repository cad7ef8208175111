"""Programs as other vendors write them for the classic EKI run unmodified, against a server or client of their kind."""

import socket
import threading

import pytest

from slabcell_drivers.krc import SoftwareKrc
from slabcell_drivers.robot.arm import KR3_R540

pytestmark = pytest.mark.integration

SENSOR_XML = b"""<ETHERNETKRL>
 <CONFIGURATION>
  <EXTERNAL><IP>192.168.1.10</IP><PORT>7000</PORT><TYPE>Server</TYPE></EXTERNAL>
  <INTERNAL>
   <Environment>Program</Environment><BUFFERING Mode="FIFO" Limit="50"/>
   <ALIVE Set_Flag="997"/><TIMEOUT Connect="2000"/><Messages Logging="warning" Display="disabled"/>
  </INTERNAL>
 </CONFIGURATION>
 <RECEIVE><XML>
  <ELEMENT Tag="res/code/@value" Type="INT"/>
  <ELEMENT Tag="res/message" Type="STRING"/>
  <ELEMENT Tag="res/grasps/le/pose/@X" Type="REAL"/><ELEMENT Tag="res/grasps/le/pose/@Y" Type="REAL"/>
  <ELEMENT Tag="res/grasps/le/pose/@Z" Type="REAL"/><ELEMENT Tag="res/grasps/le/pose/@A" Type="REAL"/>
  <ELEMENT Tag="res/grasps/le/pose/@B" Type="REAL"/><ELEMENT Tag="res/grasps/le/pose/@C" Type="REAL"/>
  <ELEMENT Tag="res/grasps/le/quality" Type="REAL"/>
  <ELEMENT Tag="res" Set_Flag="998"/>
 </XML></RECEIVE>
 <SEND><XML>
  <ELEMENT Tag="req/node"/><ELEMENT Tag="req/service"/><ELEMENT Tag="req/args/count"/>
  <ELEMENT Tag="req/args/pose/@X"/><ELEMENT Tag="req/args/pose/@Y"/><ELEMENT Tag="req/args/pose/@Z"/>
  <ELEMENT Tag="req/args/pose/@A"/><ELEMENT Tag="req/args/pose/@B"/><ELEMENT Tag="req/args/pose/@C"/>
  <ELEMENT Tag="req/end_of_request"/>
 </XML></SEND>
</ETHERNETKRL>"""

SENSOR_LIBRARY = b"""&ACCESS RVO
&REL 12
&COMMENT sensor interface
DEF SensorLib( )
;the file only holds global routines
END

GLOBAL DEF S_INIT(CFG[]:IN)
DECL CHAR CFG[]
DECL EKI_STATUS RET
RET=EKI_Init(CFG[])
EKI_CHECK(RET,#QUIT)
END

GLOBAL DEF S_OPEN(CFG[]:IN)
DECL CHAR CFG[]
DECL EKI_STATUS RET
$FLAG[S_ALIVE]=FALSE
RET=EKI_Open(CFG[])
EKI_CHECK(RET,#QUIT,CFG[])
WAIT FOR $FLAG[S_ALIVE]
END

GLOBAL DEF S_RECEIVED(RXFLAG:IN,DONEFLAG:IN)
DECL INT RXFLAG,DONEFLAG
; interrupt routine
$FLAG[RXFLAG]=FALSE
$FLAG[DONEFLAG]=TRUE
END

GLOBAL DEF S_SEND(CFG[]:IN,PATH[]:IN)
DECL CHAR CFG[],PATH[]
DECL EKI_STATUS RET
RET=EKI_ClearBuffer(CFG[],"res")
$FLAG[S_DONE]=FALSE
WAIT SEC 0 ; Force synchronization
RET=EKI_Send(CFG[],PATH[])
EKI_CHECK(RET,#NOTIFY)
END

GLOBAL DEFFCT BOOL S_WAIT(TIME:IN)
DECL REAL TIME
$TIMER[S_TIMER]=-TIME*1000
$TIMER_STOP[S_TIMER]=FALSE
WAIT FOR $FLAG[S_DONE] OR NOT $FLAG[S_ALIVE] OR $TIMER_FLAG[S_TIMER]
$TIMER_STOP[S_TIMER]=TRUE
RETURN ($FLAG[S_DONE])
ENDFCT

GLOBAL DEF S_READ(CFG[]:IN)
DECL CHAR CFG[]
DECL EKI_STATUS RET
INT I
S_MESSAGE[]=" "
RET=EKI_GetInt(CFG[],"res/code/@value",S_CODE)
RET=EKI_GetString(CFG[],"res/message",S_MESSAGE[])
RET=EKI_CheckBuffer(CFG[],"res/grasps/le/pose/@X")
S_COUNT=RET.Buff
FOR I=1 TO S_COUNT
 S_GRASP[I].POSE=$NULLFRAME
 S_GRASP[I].QUALITY=0.0
 RET=EKI_GetFrame(CFG[],"res/grasps/le/pose",S_GRASP[I].POSE)
 RET=EKI_GetReal(CFG[],"res/grasps/le/quality",S_GRASP[I].QUALITY)
ENDFOR
END
"""
SENSOR_DATA = b"""DEFDAT SensorLib PUBLIC
GLOBAL STRUC GRASP_T FRAME POSE,REAL QUALITY
DECL GLOBAL INT S_ALIVE=997
DECL GLOBAL INT S_RX=998
DECL GLOBAL INT S_DONE=900
DECL GLOBAL INT S_TIMER=7
DECL GLOBAL INT S_CODE=0
DECL GLOBAL INT S_COUNT=0
DECL GLOBAL CHAR S_MESSAGE[80]
DECL GLOBAL GRASP_T S_GRASP[50]
ENDDAT
"""
DETECT = b"""&ACCESS RVP
DEF Detect( )
DECL EKI_STATUS RET
INT TRIES
;FOLD INI
  ;FOLD BASISTECH INI
    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
    INTERRUPT ON 3
    BAS (#INITMOV,0 )
  ;ENDFOLD (BASISTECH INI)
;ENDFOLD (INI)
INTERRUPT DECL 89 WHEN $FLAG[998] DO S_RECEIVED(S_RX,S_DONE)
INTERRUPT ON 89
PTP {A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}
S_INIT("Sensor")
S_OPEN("Sensor")
S_COUNT=0
FOR TRIES=1 TO 5
 RET=EKI_SetString("Sensor","req/node","grasping")
 RET=EKI_SetString("Sensor","req/service","compute")
 RET=EKI_SetInt("Sensor","req/args/count",5)
 RET=EKI_SetFrame("Sensor","req/args/pose",$POS_ACT_MES:INV_POS($TOOL))
 S_SEND("Sensor","req")
 IF NOT S_WAIT(60.0) THEN
  MsgNotify("no answer from %1","Sensor",,"sensor")
  HALT
 ENDIF
 S_READ("Sensor")
 IF S_COUNT>0 THEN
  EXIT
 ENDIF
ENDFOR
MsgNotify(S_MESSAGE[],"Sensor",S_COUNT)
RET=EKI_Close("Sensor")
RET=EKI_Clear("Sensor")
END
"""


class Peer:
    """A thread with one TCP connection."""

    def __init__(self, work):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = self.listener.getsockname()
        self.errors = []
        self.requests = []
        self._work = work
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        self.listener.settimeout(60)
        try:
            connection, _ = self.listener.accept()
            with connection:
                connection.settimeout(60)
                self._work(self, connection)
        except OSError as error:
            self.errors.append(error)

    def close(self):
        self.listener.close()
        self._thread.join(60)
        assert self.errors == []


def read_until(connection, end):
    received = b""
    while not received.endswith(end):
        part = connection.recv(4096)
        if not part:
            return b""
        received += part
    return received


def grasp(number):
    pose = " ".join(f'{name}="{number * 10 + i}.5"' for i, name in enumerate("XYZABC"))
    return f"<le><pose {pose}></pose><quality>0.{number}</quality></le>"


def sensor(peer, connection):
    """Answer: nothing found, then three grasps, in pieces."""
    for count in (0, 3):
        peer.requests.append(read_until(connection, b"</req>"))
        body = "".join(grasp(n) for n in range(1, count + 1))
        text = f"found {count}"
        answer = f'<res><code value="{count - 1}"/><message>{text}</message><grasps>{body}</grasps></res>'.encode()
        connection.sendall(answer[:70])
        connection.sendall(answer[70:])
    read_until(connection, b"never")


def project():
    return {"Detect.src": DETECT, "SensorLib.src": SENSOR_LIBRARY, "SensorLib.dat": SENSOR_DATA}


def test_a_sensor_is_asked_until_it_finds_something_and_its_results_are_read_in_a_loop():
    peer = Peer(sensor)
    try:
        with SoftwareKrc(
            project(), robot=KR3_R540, eki_configs={"Sensor": SENSOR_XML}, eki_addresses={"Sensor": peer.address}
        ) as krc:
            assert [str(d) for d in krc.diagnostics] == []
            result = krc.run("Detect", max_wall_s=60)
            assert (result.status, result.message) == ("done", "")
            assert krc.data("SensorLib", "S_COUNT") == 3
            assert krc.data("SensorLib", "S_CODE") == 2
            second = krc.data("SensorLib", "S_GRASP[2]")
            assert second["POSE"].as_tuple() == (20.5, 21.5, 22.5, 23.5, 24.5, 25.5)
            assert second["QUALITY"] == pytest.approx(0.2)
            assert str(krc.messages[-1]) == "NOTIFY Sensor 0: found 3"
    finally:
        peer.close()
    first = peer.requests[0]
    assert first.startswith(b"<req><node>grasping</node><service>compute</service><args><count>5</count><pose ")
    assert b"<end_of_request></end_of_request></req>" in first


def test_a_sensor_that_does_not_answer_is_reported_when_the_programs_own_timer_runs_out():
    peer = Peer(lambda peer, connection: read_until(connection, b"never"))
    program = DETECT.replace(b"S_WAIT(60.0)", b"S_WAIT(0.3)")
    try:
        with SoftwareKrc(
            {**project(), "Detect.src": program},
            robot=KR3_R540,
            eki_configs={"Sensor": SENSOR_XML},
            eki_addresses={"Sensor": peer.address},
        ) as krc:
            result = krc.run("Detect", max_wall_s=60)
            krc.close()
        assert result.status == "halted"
        assert str(krc.messages[-1]) == "NOTIFY Sensor 0: no answer from sensor"
    finally:
        peer.close()


STREAM_XML = b"""<ETHERNETKRL>
 <CONFIGURATION>
  <EXTERNAL><TYPE>Client</TYPE></EXTERNAL>
  <INTERNAL>
   <ENVIRONMENT>Program</ENVIRONMENT><BUFFERING Mode="FIFO" Limit="512"/>
   <ALIVE Set_Flag="1"/><IP>127.0.0.1</IP><PORT>54600</PORT><PROTOCOL>TCP</PROTOCOL>
  </INTERNAL>
 </CONFIGURATION>
 <RECEIVE><XML>
  <ELEMENT Tag="Cmd/Pos/@A1" Type="REAL"/><ELEMENT Tag="Cmd/Pos/@A2" Type="REAL"/>
  <ELEMENT Tag="Cmd/Pos/@A3" Type="REAL"/>
  <ELEMENT Tag="Cmd/Stop" Type="BOOL"/>
 </XML></RECEIVE>
 <SEND><XML>
  <ELEMENT Tag="State/Pos/@A1"/><ELEMENT Tag="State/Pos/@A2"/>
  <ELEMENT Tag="State/Pos/@A3"/><ELEMENT Tag="State/Waiting"/>
 </XML></SEND>
</ETHERNETKRL>"""
STREAM = b"""&ACCESS RVP
def stream( )
decl axis cmd
decl eki_status ret
decl int got
bool halted
bas(#initmov, 0)
$advance=5
ret=EKI_Init("Stream")
ret=EKI_Open("Stream")
wait for $flag[1]
cmd={a1 0.0,a2 -90.0,a3 90.0,a4 0.0,a5 30.0,a6 0.0}
ptp cmd
got=0
halted=false
loop
  ; send the state with every turn
  ret=EKI_SetReal("Stream","State/Pos/@A1",$axis_act.a1)
  ret=EKI_CheckBuffer("Stream","Cmd/Pos/@A1")
  ret=EKI_SetInt("Stream","State/Waiting",ret.buff)
  ret=EKI_CheckBuffer("Stream","Cmd/Stop")
  if ret.buff>0 then
    ret=EKI_GetBool("Stream","Cmd/Stop",halted)
    ret=EKI_GetReal("Stream","Cmd/Pos/@A1",cmd.a1)
    ret=EKI_GetReal("Stream","Cmd/Pos/@A2",cmd.a2)
    ret=EKI_GetReal("Stream","Cmd/Pos/@A3",cmd.a3)
    got=got+1
    ptp cmd c_ptp
    if halted then
      exit
    endif
  else
    wait sec 0.012
  endif
endloop
wait sec 0
ret=EKI_SetReal("Stream","State/Pos/@A1",$axis_act.a1)
ret=EKI_Send("Stream","State")
ret=EKI_Clear("Stream")
end
"""


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


def test_a_controller_that_is_the_server_follows_streamed_points_until_it_is_told_to_stop():
    address = ("127.0.0.1", free_port())
    received = []

    def client():
        for _ in range(3000):
            try:
                connection = socket.create_connection(address, timeout=60)
                break
            except ConnectionRefusedError:
                threading.Event().wait(0.02)
        with connection:
            for i in range(1, 21):
                stop = int(i == 20)
                connection.sendall(
                    f'<Cmd><Pos A1="{i}" A2="{-90 + i}" A3="{90 - i}"></Pos><Stop>{stop}</Stop></Cmd>'.encode()
                )
            received.append(read_until(connection, b"</State>"))

    with SoftwareKrc(
        {"stream.src": STREAM}, robot=KR3_R540, eki_configs={"Stream": STREAM_XML}, eki_addresses={"Stream": address}
    ) as krc:
        thread = threading.Thread(target=client)
        thread.start()
        result = krc.run("stream", max_wall_s=60)
        thread.join(60)
    assert (result.status, result.message) == ("done", "")
    assert krc.axes_deg[:3] == pytest.approx((20, -70, 70))
    assert b'A1="20.' in received[0]
    assert b"<Waiting>" in received[0]


def test_a_mixed_up_network_address_is_a_status_that_the_program_can_act_on():
    program = b"""DEF t()
DECL EKI_STATUS RET
RET=EKI_Init("Sensor")
RET=EKI_Open("Sensor")
IF NOT RET.Connected THEN
 N=RET.MSG_NO
 EKI_CHECK(RET,#NOTIFY)
ENDIF
RET=EKI_Init("Nothing")
M=RET.MSG_NO
END
"""
    with SoftwareKrc(
        {"t.src": program, "t.dat": b"DEFDAT t PUBLIC\nINT N=0\nINT M=0\nENDDAT\n"},
        robot=KR3_R540,
        eki_configs={"Sensor": SENSOR_XML},
        eki_addresses={"Sensor": ("127.0.0.1", free_port())},
    ) as krc:
        assert krc.run("t", max_wall_s=60).status == "done"
        assert krc.data("t", "N") == 14
        assert krc.data("t", "M") == 3
        assert "EKI00014" in krc.messages[-1].text


def test_a_text_or_frame_that_its_variable_cannot_hold_is_a_status():
    program = b"""DEF t()
DECL EKI_STATUS RET
CHAR short[3]
CHAR long[30]
FRAME unset[2]
RET=EKI_Init("Broken")
CODE[1]=RET.MSG_NO
RET=EKI_Init("Sensor")
RET=EKI_Open("Sensor")
WAIT FOR $FLAG[998]
short[]="abc"
long[]="-"
RET=EKI_GetString("Sensor","res/message",short[])
CODE[2]=RET.MSG_NO
KEPT=short[1]=="a"
RET=EKI_GetString("Sensor","res/message",long[])
CODE[3]=RET.MSG_NO
RET=EKI_GetFrameArray("Sensor","res/grasps/le/pose",unset[])
CODE[4]=RET.MSG_NO
END
"""

    def talk(peer, connection):
        connection.sendall(b"<res><message>four</message></res><res><message>fifth</message></res>")
        read_until(connection, b"never")

    peer = Peer(talk)
    try:
        with SoftwareKrc(
            {"t.src": program, "t.dat": b"DEFDAT t PUBLIC\nINT CODE[4]\nBOOL KEPT=FALSE\nENDDAT\n"},
            robot=KR3_R540,
            eki_configs={"Sensor": SENSOR_XML, "Broken": b"<ETHERNETKRL>"},
            eki_addresses={"Sensor": peer.address},
        ) as krc:
            result = krc.run("t", max_wall_s=60)
            assert (result.status, result.message) == ("done", "")
            assert [krc.data("t", f"CODE[{i}]") for i in (1, 2, 3, 4)] == [22, 27, 0, 26]
            assert krc.data("t", "KEPT") is True
    finally:
        peer.close()


def test_waits_after_the_channel_is_closed_take_no_real_time():
    program = b"""DEF t()
DECL EKI_STATUS RET
RET=EKI_Init("Sensor")
RET=EKI_Open("Sensor")
RET=EKI_CheckBuffer("Sensor","res/message")
RET=EKI_Clear("Sensor")
WAIT SEC 2000
END
"""
    peer = Peer(lambda peer, connection: read_until(connection, b"never"))
    try:
        with SoftwareKrc(
            {"t.src": program},
            robot=KR3_R540,
            eki_configs={"Sensor": SENSOR_XML},
            eki_addresses={"Sensor": peer.address},
        ) as krc:
            assert krc.run("t", max_wall_s=100).status == "done"
    finally:
        peer.close()
