"""Channel files, programs and schema: what does not fit is found, and what fits is left alone."""

from pathlib import Path

import pytest

from slabcell_drivers.robot.eki.consistency import check

pytestmark = pytest.mark.unit
KRL = Path(__file__).parents[3] / "krl"
PROJECT = {path.name: path.read_bytes() for path in KRL.iterdir() if path.is_file()}


def changed(name, old, new):
    assert old.encode() in PROJECT[name]
    return {**PROJECT, name: PROJECT[name].replace(old.encode(), new.encode())}


def said(files):
    return [f"{finding.file}:{finding.line}: {finding.severity}: {finding.message}" for finding in check(files)]


def line_of(name, text):
    return PROJECT[name].decode().splitlines().index(text) + 1


def test_the_shipped_files_fit():
    assert said(PROJECT) == []


def test_one_role_alone_fits():
    assert said({name: raw for name, raw in PROJECT.items() if name != "SlabCellServer.xml"}) == []


def test_a_misspelt_path_is_found_in_its_line():
    wrong = changed("VT.src", '"Vis/Head/@Ack",ACK', '"Vis/Head/@Akc",ACK')
    line = line_of("VT.src", 'RET=EKI_GetInt(VT_CH[],"Vis/Head/@Ack",ACK)')
    expected = f'VT.src:{line}: error: "Vis/Head/@Akc" is not among the RECEIVE elements in SlabCell.xml'
    assert expected in said(wrong)
    assert any("Vis/Head/@Ack has a memory that no program reads" in text for text in said(wrong))


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("VT.src", 'EKI_GetReal(VT_CH[],"Vis/Part/@Score",S)', 'EKI_GetInt(VT_CH[],"Vis/Part/@Score",N)', "reads"),
        ("VT.src", '"Vis/Pick",F', '"Vis/Part",F', "is no frame among the RECEIVE elements: it lacks @X"),
        ("VT.src", '"Robot/Job/@Id"', '"Robot/Job/@ID"', "not among the SEND elements"),
        ("VT.src", 'EKI_Send(VT_CH[],"Robot")', 'EKI_Send(VT_CH[],"Robot/Haed")', "not among the SEND elements"),
        (
            "VT.src",
            'EKI_ClearBuffer(VT_CH[],"Vis")',
            'EKI_ClearBuffer(VT_CH[],"Viz")',
            "not among the RECEIVE elements",
        ),
        ("VT.src", 'RET=EKI_SetInt(VT_CH[],"Robot/Stat/@Err",0)', "", "Robot/Stat/@Err is never set"),
        ("VT.dat", "VT_FLAGRX=998", "VT_FLAGRX=999", "VT_FLAGRX is 999, but SlabCell.xml sets flag 998"),
        ("VT.dat", 'VT_CH[]="SlabCell"', 'VT_CH[]="SlabCel"', "no channel file SLABCEL.xml"),
        ("SlabCell.xml", 'ALIVE Set_Flag="997"', 'ALIVE Set_Flag="995"', "VT_FLAGALIVE is 997"),
        ("SlabCell.xml", '<ELEMENT Tag="Vis/Msg" Type="STRING"/>', "", "Vis/Msg is missing from RECEIVE"),
        ("SlabCell.xml", 'Tag="Vis/Res/@Left" Type="INT"', 'Tag="Vis/Res/@Left" Type="REAL"', "the schema says INT"),
        (
            "SlabCell.xml",
            '<ELEMENT Tag="Robot/Head/@Ver"/>',
            '<ELEMENT Tag="Robot/Head/@V"/>',
            "not in the telegram schema",
        ),
        ("SlabCell.xml", "</ETHERNETKRL>", "", "not well-formed XML"),
        ("SlabCell.xml", "<ETHERNETKRL>", "<!DOCTYPE a><ETHERNETKRL>", "document type"),
    ],
)
def test_a_difference_is_found(name, old, new, message):
    found = said(changed(name, old, new))
    assert any(message in text for text in found), found


def test_a_comment_and_a_semicolon_in_a_string_are_told_apart():
    assert said({**PROJECT, "More.src": b'; RET=EKI_GetInt(VT_CH[],"Vis/No",N)\n'}) == []
    assert len(said({**PROJECT, "More.src": b'SC_NOTIFY(";") RET=EKI_GetInt(VT_CH[],"Vis/No",N)\n'})) == 2


def test_a_foreign_channel_is_checked_against_its_own_programs_only():
    xml = (
        b"<EthernetKRL><Configuration/><Receive><Xml><Element Tag='res/pose' Type='FRAME' Set_Flag='12'/>"
        b"<Element Tag='res/n' Type='INT'/></Xml></Receive>"
        b"<Send><Xml><Element Tag='req/cmd'/></Xml></Send></EthernetKRL>"
    )
    src = (
        b'DEF Other()\nRET=EKI_SetString("Sensor","req/cmd","go")\nRET=EKI_Send("Sensor","req")\n'
        b'RET=EKI_GetFrame("Sensor","res/pose",F)\nRET=EKI_GetInt("Sensor","res/n",N)\n'
        b'RET=EKI_Send("Sensor","raw text")\nEND\n'
    )
    assert said({**PROJECT, "Sensor.xml": xml, "Other.src": src}) == []
    assert any(
        "res/m" in text for text in said({**PROJECT, "Sensor.xml": xml, "Other.src": src.replace(b"res/n", b"res/m")})
    )


def test_xml_that_is_no_channel_is_passed_over():
    assert said({**PROJECT, "other.xml": b"<html/>"}) == []


def test_texts_for_the_smartpad_have_at_most_80_characters():
    for name, raw in PROJECT.items():
        if name.endswith(".src"):
            for number, line in enumerate(raw.decode("ascii").splitlines(), 1):
                for text in line.split('"')[1::2]:
                    assert len(text) <= 80, f"{name}:{number}"


def test_programs_are_ascii_in_lines_a_smartpad_can_show():
    for name, raw in PROJECT.items():
        assert raw.isascii(), name
        if name.endswith(".src"):
            for number, line in enumerate(raw.decode().splitlines(), 1):
                assert len(line) <= 90, f"{name}:{number}"


def test_programs_that_compute_their_paths_are_not_said_to_leave_elements_unread():
    without = changed("VT.src", 'RET=EKI_GetInt(VT_CH[],"Vis/Res/@Idx",N)\n', "")
    assert any("Vis/Res/@Idx has a memory" in text for text in said(without))
    computed = changed("VT.src", 'RET=EKI_GetInt(VT_CH[],"Vis/Res/@Idx",N)\n', "RET=EKI_GetInt(VT_CH[],PATH[],N)\n")
    assert said(computed) == []
