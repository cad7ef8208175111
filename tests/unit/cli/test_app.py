"""The command as the shell sees it: verbs, exit codes, and words instead of tracebacks."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from slabcell.cli import app
from slabcell.errors import ConfigurationError, SlabcellError, UnavailableError

pytestmark = pytest.mark.unit

TEMPLATES = Path(__file__).resolve().parents[3] / "config" / "templates"


def call(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["slabcell", *words])
    with pytest.raises(SystemExit) as left:
        app.main()
    return int(left.value.code or 0)


def test_help_lists_every_verb(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(monkeypatch, "--help") == 0
    shown = capsys.readouterr().out
    assert all(verb in shown for verb in app.VERBS)


@pytest.mark.parametrize("verb", list(app.VERBS))
def test_every_verb_has_help(verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(monkeypatch, verb, "--help") == 0
    assert "Usage: " in capsys.readouterr().out


@pytest.mark.parametrize("words", [("juggle",), ("--juggle",), ("template", "juggle"), ("locate",)])
def test_wrong_usage_ends_with_2(words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    assert call(monkeypatch, *words) == 2


def test_version_is_printed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(monkeypatch, "--version") == 0
    assert capsys.readouterr().out.startswith("slabcell 0.")


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (SlabcellError("it broke", number=1101), 1, "error [1101]: it broke"),
        (ConfigurationError("cell.toml: wrong"), 78, "error: cell.toml: wrong"),
        (UnavailableError("gone"), 69, "error: gone"),
        (RuntimeError("a bug"), 70, "internal error: RuntimeError: a bug"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_an_error_becomes_words_and_an_exit_code(
    error: BaseException, code: int, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_used: str | None) -> None:
        raise error

    monkeypatch.setattr(app, "_build", fail)
    monkeypatch.delenv("SLABCELL_DEBUG", raising=False)
    assert call(monkeypatch, "demo") == code
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said


def test_a_reader_that_goes_away_is_no_error() -> None:
    script = f"{sys.executable} -c 'from slabcell.cli import main; main()' --help | true"
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.stderr == ""


def test_template_check_lists_slots_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["slabcell", "template", "check", str(TEMPLATES / "dresden.csv"), "--json"])
    with pytest.raises(SystemExit) as left:
        app.main()
    assert not left.value.code
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "slabcell.template-check/1"
    assert [slot["area_mm2"] for slot in document["slots"]] == [4400.0, 3344.0, 2500.0, 1900.0, 2200.0]


def test_template_check_reports_problems_as_json_with_the_configuration_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "t.csv").write_text("1,2,3\n")
    assert call(monkeypatch, "template", "check", str(tmp_path / "t.csv"), "--json") == 78
    assert "odd" in json.loads(capsys.readouterr().out)["problems"][0]


def test_template_show_draws_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "t.png"
    assert call(monkeypatch, "template", "show", str(TEMPLATES / "irregular.csv"), "--out", str(out)) == 0
    assert out.read_bytes().startswith(b"\x89PNG")
