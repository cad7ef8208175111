"""The commands around KRL: `slabcell krl check` and `slabcell krc run`, as a shell sees them."""

import json
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from slabcell.cli import main

pytestmark = pytest.mark.integration

KRL = Path(__file__).parents[2] / "krl"
PROGRAM = """DEF move()
INT i
BAS(#INITMOV,0)
PTP {A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}
$OUT[3]=TRUE
BAS(#TOOL,2)
FOR i=1 TO 3
PTP_REL {A1 5}
ENDFOR
count=count+1
MsgNotify("moved","demo")
END
"""


@dataclass
class Done:
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def slabcell(monkeypatch, capsys):
    """The command in this process; only its start costs a second in one of its own."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["slabcell", *map(str, arguments)])
        try:
            main()
        except SystemExit as end:
            code = end.code
        else:
            code = 0
        captured = capsys.readouterr()
        return Done(code or 0, captured.out, captured.err)

    return run


@pytest.fixture
def project(tmp_path):
    (tmp_path / "move.src").write_text(PROGRAM)
    (tmp_path / "move.dat").write_text("DEFDAT move PUBLIC\nINT count=4\nENDDAT\n")
    return tmp_path


@pytest.fixture
def run(slabcell, project):
    tool = "TOOL_DATA[2]={X 0,Y 0,Z 100,A 0,B 0,C 0}"

    def run_program(*arguments, program="move.src"):
        return slabcell("krc", "run", program, "--project", project, "--set", tool, *arguments)

    return run_program


def test_a_program_is_run_to_its_end(run):
    done = run()
    assert done.returncode == 0, done.stderr
    assert "NOTIFY demo 0: moved" in done.stdout
    assert "done; " in done.stdout


def test_the_result_is_one_json_object_with_the_trace_that_was_asked_for(run):
    done = run("--json", "--trace", "motion,io,statements")
    document = json.loads(done.stdout)
    assert document["schema"] == "slabcell.krc-run/1"
    assert document["status"] == "done"
    assert document["axes_deg"][0] == pytest.approx(15)
    kinds = [event["kind"] for event in document["trace"]]
    assert kinds.count("motion") == 4
    assert kinds.count("io") == 1
    assert kinds.count("statement") >= 10
    assert document["messages"] == ["NOTIFY demo 0: moved"]


def test_the_path_is_drawn_and_the_data_kept(run, tmp_path):
    done = run("--picture", tmp_path / "out" / "path.svg", "--keep", tmp_path / "kept")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "path.svg").read_text().startswith("<svg")
    assert "count=5" in (tmp_path / "kept" / "move.dat").read_text()


@pytest.mark.parametrize(
    ("change", "code", "text"),
    [
        (("count=count+1", "HALT"), 1, "halted: 91030 HALT in move.src, line 10"),
        (("count=count+1", "count=1/0"), 1, "division by 0 in move.src, line 10"),
        (("count=count+1", "count="), 1, "move.src:10:7"),
        (("count=count+1", "WAIT FOR $IN[1]"), 1, "did not end within 1 s"),
    ],
)
def test_a_program_that_does_not_end_well_has_exit_code_1_and_says_why(run, project, change, code, text):
    (project / "move.src").write_text(PROGRAM.replace(*change))
    done = run("--timeout", "1")
    assert done.returncode == code
    assert text in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--robot", "kr999"), "no arm is called"),
        (("--speed", "fast"), "a number from 0.001 to 1000, or max"),
        (("--trace", "everything"), "not one of statements, motion"),
        (("--address", "SlabCell"), "CHANNEL=HOST:PORT"),
        (("--set", "NOTHERE=1"), "NOTHERE is not declared"),
        (("--set", "TOOL_DATA[1]="), "is no value"),
        (("--eki", "nowhere"), "no such folder"),
    ],
)
def test_wrong_usage_has_exit_code_2_and_says_what_is_expected(run, arguments, text):
    done = run(*arguments)
    assert done.returncode == 2
    assert text in done.stderr
    assert "Traceback" not in done.stderr


def test_a_program_that_is_not_there_is_named_with_those_that_are(run):
    done = run(program="other")
    assert done.returncode == 1
    assert "there are: MOVE" in done.stdout


def test_the_shipped_programs_check_clean(slabcell):
    done = slabcell("krl", "check", KRL)
    assert done.returncode == 0, done.stdout
    assert " 0 errors, 0 warnings" in done.stdout


def test_a_check_prints_what_compilers_print_and_json_on_request(slabcell, tmp_path):
    (tmp_path / "bad.src").write_text("DEF bad()\nx=\nRETURN 5\nEND\n")
    done = slabcell("krl", "check", tmp_path / "bad.src")
    assert done.returncode == 1
    assert "bad.src:2:3: error: expected an expression, found the end of the line [syntax]" in done.stdout
    document = json.loads(slabcell("krl", "check", "--json", tmp_path).stdout)
    assert document["schema"] == "slabcell.krl-check/1"
    assert (document["errors"], document["files"]) == (2, 1)
    assert {d["code"] for d in document["diagnostics"]} == {"syntax", "return"}


CHANNEL = """<ETHERNETKRL>
<CONFIGURATION>
<EXTERNAL><TYPE>Client</TYPE></EXTERNAL>
<INTERNAL><PORT>54601</PORT><PROTOCOL>TCP</PROTOCOL><BUFFERING Limit="16"/></INTERNAL>
</CONFIGURATION>
</ETHERNETKRL>
"""


@pytest.mark.parametrize(
    ("old", "new", "code", "text"),
    [
        ("", "", 0, "1 files, 0 errors, 0 warnings"),
        ('Limit="16"', 'Limit="600"', 1, "4:1: error: Limit '600' is not a whole number from 1 to 512"),
        ("TCP", "UDP", 0, "3:1: warning: PROTOCOL UDP is not emulated"),
        ("54601", "7000", 0, "warning: port 7000: on the KLI a controller opens 54600 to 54615"),
        ("</ETHERNETKRL>", "", 1, "not well-formed XML"),
    ],
)
def test_a_check_says_what_eki_would_refuse_of_a_channel_file(slabcell, tmp_path, old, new, code, text):
    (tmp_path / "Channel.xml").write_text(CHANNEL.replace(old, new) if old else CHANNEL)
    done = slabcell("krl", "check", tmp_path)
    assert done.returncode == code
    assert text in done.stdout


@pytest.mark.parametrize("name", ["nothing.src", "text.txt", ""])
def test_a_check_of_nothing_is_wrong_usage(slabcell, tmp_path, name):
    (tmp_path / "text.txt").write_text("x")
    done = slabcell("krl", "check", tmp_path / name)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_the_command_of_the_shell_does_the_same(project):
    command = [sys.executable, "-c", "from slabcell.cli import main; main()", "krl", "check", str(project)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0
    assert "2 files, 0 errors, 0 warnings" in done.stdout


ASKING = """DEF ask()
INT first,second
MsgDialog(first,"Which side?","demo",,"Left","Right")
MsgDialog(second,"Sure?","demo",,"Yes","No")
IF (first==7) AND (second==6) THEN
MsgNotify("left, but not sure","demo")
ENDIF
END
"""


def test_dialogs_are_answered_from_the_command_line_by_text_or_number(slabcell, tmp_path):
    (tmp_path / "ask.src").write_text(ASKING)
    done = slabcell("krc", "run", "ask", "--project", tmp_path, "--answer", "left", "--answer", "6")
    assert done.returncode == 0, done.stderr
    assert "left, but not sure" in done.stdout


def test_ctrl_c_cancels_the_program_as_a_person_at_the_controller_would(tmp_path):
    (tmp_path / "ever.src").write_text("DEF ever()\nLOOP\n$FLAG[1]=NOT $FLAG[1]\nWAIT SEC 1\nENDLOOP\nEND\n")
    # what starts the tests may have it ignored, and children inherit that
    start = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from slabcell.cli import main; main()"
    )
    command = [sys.executable, "-u", "-c", start, "krc", "run", "ever", "--project", str(tmp_path)]
    with subprocess.Popen(
        [*command, "--trace", "statements"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        for _ in range(200):
            assert "ever.src" in running.stdout.readline()
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=60)
    assert running.returncode == 1, err
    assert out.splitlines()[-1].startswith("cancelled: 91031 the program was cancelled in ever.src")


def test_a_submit_program_runs_beside_the_program_if_it_is_named(slabcell, tmp_path):
    (tmp_path / "sps.sub").write_text("DEF sps()\nWAIT SEC 0.1\n$FLAG[5]=TRUE\nEND\n")
    (tmp_path / "main.src").write_text("DEF main()\nWAIT FOR $FLAG[5]\nEND\n")
    done = slabcell("krc", "run", "main", "--project", tmp_path, "--submit", "sps")
    assert done.returncode == 0, done.stdout
    assert slabcell("krc", "run", "main", "--project", tmp_path, "--timeout", "0.5").returncode == 1
    unknown = slabcell("krc", "run", "main", "--project", tmp_path, "--submit", "other")
    assert unknown.returncode == 1
    assert "there is no program other" in unknown.stdout


def test_an_answer_that_the_dialog_does_not_have_is_wrong_usage_and_names_those_it_has(slabcell, tmp_path):
    (tmp_path / "ask.src").write_text(ASKING)
    done = slabcell("krc", "run", "ask", "--project", tmp_path, "--answer", "up")
    assert done.returncode == 2
    assert "--answer up: the dialog 'Which side?' has the softkeys 6 Right, 7 Left" in done.stderr


def test_a_dialog_without_an_answer_stands_and_is_named_at_the_time_limit(slabcell, tmp_path):
    (tmp_path / "ask.src").write_text(ASKING)
    done = slabcell("krc", "run", "ask", "--project", tmp_path, "--answer", "left", "--timeout", "0.5")
    assert done.returncode == 1
    assert "the dialog 'Sure?' was not answered" in done.stdout
