from pathlib import Path

import pytest

from slabcell_drivers.krc.eki_config import (
    Buffering,
    EkiConfigError,
    ElementType,
    Environment,
    Role,
    parse_config,
)

pytestmark = pytest.mark.unit

KRL = Path(__file__).parents[3] / "krl"

WRONG_CASE = b"""<?xml version="1.0"?>
<!-- names as they are found in shipped examples -->
<EthernetKRL>
  <Configuration>
    <External><Ip>10.0.0.1</Ip><Port>6008</Port></External>
    <Internal>
      <Environment>submit</Environment>
      <Buffering mode="lifo" limit="20"/>
      <BuffSize Limit="512"/>
      <Timeout CONNECT="60000"/>
      <Alive set_out="42" Ping="200"/>
      <Ip>10.0.0.2</Ip><Port>54600</Port><Protocol>tcp</Protocol>
      <Messages Logging="error" Display="disabled"/>
    </Internal>
  </Configuration>
  <Receive><Xml>
    <Element Tag="Sensor/Message" Type="string" Set_Flag="1"/>
    <Element Tag="Sensor/Pos/@X" Type="REAL" Mode="FIFO"/>
    <Element Tag="Sensor/Read/xyzabc" Type="FRAME"/>
    <Element Tag="Ext" SET_FLAG="56"/>
  </Xml></Receive>
  <Send><Xml><Element Tag="Robot/Data/@X" Type="REAL"/><Element Tag="Robot/Status"/></Xml></Send>
</EthernetKRL>"""


def minimal(internal: str = "", receive: str = "", external: str = "<IP>10.0.0.1</IP><PORT>6008</PORT>") -> bytes:
    return (
        f"<ETHERNETKRL><CONFIGURATION><EXTERNAL>{external}</EXTERNAL><INTERNAL>{internal}</INTERNAL></CONFIGURATION>"
        f"<RECEIVE>{receive}</RECEIVE><SEND><XML/></SEND></ETHERNETKRL>"
    ).encode()


def test_element_and_attribute_names_are_read_in_any_letter_case() -> None:
    config = parse_config(WRONG_CASE)
    assert config.role is Role.CLIENT
    assert (config.external_ip, config.external_port) == ("10.0.0.1", 6008)
    assert config.environment is Environment.SUBMIT
    assert (config.buffering, config.memory_limit, config.buffer_bytes) == (Buffering.LIFO, 20, 512)
    assert (config.connect_timeout_s, config.alive_out, config.alive_flag, config.ping_s) == (60.0, 42, None, 200)
    assert [(e.tag, e.type, e.set_flag, e.mode) for e in config.receive] == [
        ("Sensor/Message", ElementType.STRING, 1, Buffering.LIFO),
        ("Sensor/Pos/@X", ElementType.REAL, None, Buffering.FIFO),
        ("Sensor/Read/xyzabc", ElementType.FRAME, None, Buffering.LIFO),
        ("Ext", None, 56, Buffering.LIFO),
    ]
    assert config.send == ("Robot/Data/@X", "Robot/Status")


def test_what_is_not_given_has_the_defaults_of_the_manual() -> None:
    config = parse_config(minimal())
    assert config.environment is Environment.PROGRAM
    assert (config.buffering, config.memory_limit, config.buffer_bytes) == (Buffering.FIFO, 16, 16384)
    assert (config.internal_port, config.connect_timeout_s, config.ping_s) == (54600, None, None)


@pytest.mark.parametrize("name", ["SlabCell.xml", "SlabCellServer.xml"])
def test_the_shipped_configurations_are_taken(name: str) -> None:
    config = parse_config((KRL / name).read_bytes())
    assert config.role is (Role.SERVER if "Server" in name else Role.CLIENT)
    assert config.receive
    assert config.send


@pytest.mark.parametrize(
    ("raw", "problem"),
    [
        (b"", "no element found"),
        (b"<A/>", "root is <A>"),
        (b"<ETHERNETKRL><CONFIGURATION/></ETHERNETKRL>", "<EXTERNAL> is missing"),
        (minimal(external="<TYPE>Server</TYPE>"), "IP and PORT of the external system are needed"),
        (minimal(external="<TYPE>Peer</TYPE>"), "TYPE 'Peer' is not one of Server, Client"),
        (minimal(external="<IP>1</IP><PORT>70000</PORT>"), "PORT '70000' is not a whole number from 1 to 65534"),
        (minimal('<BUFFERING Limit="513"/>'), "Limit '513' is not a whole number from 1 to 512"),
        (minimal('<BUFFERING Mode="ring"/>'), "Mode 'ring' is not FIFO or LIFO"),
        (minimal('<ALIVE Set_Flag="1025"/>'), "Set_Flag '1025'"),
        (minimal('<TIMEOUT Connect="-1"/>'), "Connect '-1'"),
        (minimal("<PROTOCOL>UDP</PROTOCOL>"), "UDP is not emulated"),
        (minimal("<ENVIRONMENT>Cell</ENVIRONMENT>"), "ENVIRONMENT 'Cell'"),
        (minimal(receive='<XML><ELEMENT Tag="A" Type="WORD"/></XML>'), "Type 'WORD' is not one of"),
        (minimal(receive="<XML><ELEMENT/></XML>"), "without Tag"),
        (minimal(receive='<XML><THING Tag="A"/></XML>'), "<THING> where <ELEMENT> is expected"),
        (minimal(receive='<XML><ELEMENT Tag="A"/><ELEMENT Tag="A"/></XML>'), "tag A is configured 2 times"),
        (minimal(receive='<RAW><ELEMENT Tag="B" Type="BYTE"/></RAW>'), "BYTE needs a Size"),
        (minimal(receive='<RAW><ELEMENT Tag="B" Type="STREAM" EOS="13,x"/></RAW>'), "EOS '13,x'"),
        (
            minimal(
                receive='<RAW><ELEMENT Tag="A" Type="BYTE" Size="1"/><ELEMENT Tag="B" Type="BYTE" Size="1"/></RAW>'
            ),
            "exactly one raw memory",
        ),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "document type is not allowed"),
        (b" " * 300_000, "at most 262144"),
    ],
)
def test_a_wrong_configuration_says_where_and_what(raw: bytes, problem: str) -> None:
    with pytest.raises(EkiConfigError, match=problem.replace("(", r"\(")):
        parse_config(raw)


def test_every_problem_of_a_file_is_reported() -> None:
    raw = minimal('<BUFFERING Limit="0"/><BUFFSIZE Limit="0"/><ALIVE Ping="0"/>')
    with pytest.raises(EkiConfigError) as caught:
        parse_config(raw)
    assert len(caught.value.problems) == 3
    assert all(str(problem).startswith("line 1: ") for problem in caught.value.problems)
