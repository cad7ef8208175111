from pathlib import Path

import pytest

from slabcell_drivers.krc.eki_messages import EKI_MESSAGE_TEXTS, EkiMessage
from slabcell_drivers.krc.unconfirmed import ASSUMPTIONS

pytestmark = pytest.mark.unit

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "eki-emulation.md"


def test_the_page_lists_exactly_the_assumptions_and_messages_of_the_code() -> None:
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    assert [row for row in rows if row.split(" | ")[0].removeprefix("| ") in ASSUMPTIONS] == [
        f"| {name} | {text} |" for name, text in ASSUMPTIONS.items()
    ]
    assert [row for row in rows if row[2].isdigit()] == [
        f"| {int(number)} | {text} |" for number, text in EKI_MESSAGE_TEXTS.items()
    ]


def test_every_message_has_a_text() -> None:
    assert set(EKI_MESSAGE_TEXTS) == set(EkiMessage) - {EkiMessage.NONE}
