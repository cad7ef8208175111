"""What a person reads is whole: nothing is cut off in a pipe, and no brackets are taken for markup."""

import pytest
from rich.table import Table

from slabcell.cli.talk import make_console

pytestmark = pytest.mark.unit


def test_a_table_in_a_pipe_is_as_wide_as_what_it_says(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    words = "[camera] driver aravis: " + "no such library " * 12
    table = Table("detail")
    table.add_row(words)
    make_console().print(table)
    assert words.rstrip() in capsys.readouterr().out


def test_words_in_brackets_are_shown_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    make_console().print("cell [/b] [bold]one")
    assert capsys.readouterr().out == "cell [/b] [bold]one\n"
