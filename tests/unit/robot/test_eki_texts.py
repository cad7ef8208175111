"""What the programs show on the SmartPAD is what the error catalogue says."""

import re
from pathlib import Path

import pytest

from slabcell.catalogue import Fault, entry
from slabcell_drivers.robot.answering import HANDLER_FAILED_CODE
from slabcell_drivers.robot.eki.krl_constants import constants_fold
from slabcell_drivers.robot.eki.schema import CHANNEL, MAX_TEXT_CHARS

pytestmark = pytest.mark.unit
KRL = Path(__file__).parents[3] / "krl"
TEXTS = [text for path in KRL.glob("*.src") for text in re.findall(r'"([^"\n]+)"', path.read_text("ascii"))]
NUMBERED = sorted({text for text in TEXTS if re.match(r"\d{4} ", text)})


@pytest.mark.parametrize("text", NUMBERED)
def test_a_numbered_text_is_the_catalogues(text):
    assert entry(int(text[:4])).robot == text


def test_every_error_of_the_program_in_the_catalogue_is_shown_by_the_program():
    own = {int(fault) for fault in Fault if 2000 <= fault < 2100}
    assert {int(text[:4]) for text in NUMBERED if text.startswith("20")} == own


def test_the_numbers_of_messages_and_texts_agree():
    for path in KRL.glob("*.src"):
        for text, number in re.findall(r'SC_TEXT\[\]="(\d{4}) [^"]*"\s+SC_STOPWITH\((\d+)\)', path.read_text("ascii")):
            assert text == number, path.name


def test_every_text_fits_the_message_window():
    assert TEXTS
    assert max(map(len, TEXTS)) <= MAX_TEXT_CHARS


def test_the_codes_of_the_programs_own_errors_are_in_the_catalogue():
    codes = [int(code) for code in re.findall(r"VT_E\w+=(\d{4})", constants_fold(CHANNEL))]
    assert sorted(set(codes)) == [Fault.CELL_NOT_ANSWERING, Fault.RESULT_REFUSED, Fault.WRONG_VERSION]


def test_the_links_own_error_is_in_the_catalogue():
    assert Fault(HANDLER_FAILED_CODE) is Fault.INTERNAL
