"""Which pages are drawn from the code?  Writes them; with ``--check`` says which of them are not what the code says.

python docs/generate.py [--check]
"""

import argparse
import json
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from slabcell.catalogue import Clears, Entry, catalogue
from slabcell.cell.reconcile import Decision, reconcile
from slabcell.cell.records import STEPS, OfferState
from slabcell.cell.states import TABLE, CellState, HeldCause, SuspendedCause
from slabcell.hmi.pages import PAGES
from slabcell.service.api.app import ENDPOINTS, description
from slabcell.service.config import CellConfig, FrameConfig
from slabcell.service.config_reload import is_reloadable
from slabcell.service.event_feed import KINDS
from slabcell.service.recipe_schema import recipe_schema
from slabcell_drivers.robot.protocol import AckState

DOCS = Path(__file__).parent
END = "<!-- end of the generated part -->"
NOTE = "<!-- Drawn from the code by docs/generate.py: change the code, then run it. -->\n\n"


def pages() -> dict[Path, str]:
    """Return every generated page by its path."""
    architecture = DOCS / "explanation" / "architecture.md"
    configuration = DOCS / "reference" / "configuration.md"
    control_api = DOCS / "reference" / "control-api.md"
    return {
        DOCS / "reference" / "states.md": states_page(),
        DOCS / "reference" / "errors.md": errors_page(catalogue().values()),
        DOCS / "reference" / "exactly-once.md": exactly_once_page(),
        DOCS / "reference" / "faults.md": faults_page(),
        DOCS / "reference" / "pages.md": actions_page(),
        architecture: _between_marks(architecture.read_text(encoding="utf-8"), "states", state_diagram()),
        control_api: _between_marks(control_api.read_text(encoding="utf-8"), "resources", resources_table()),
        configuration: _between_marks(configuration.read_text(encoding="utf-8"), "keys", config_table(CellConfig)),
        DOCS / "reference" / "cell-config.schema.json": _json(CellConfig.model_json_schema()),
        DOCS / "reference" / "recipe.schema.json": _json(recipe_schema()),
        DOCS / "reference" / "control-api.json": _json(description()),
    }


def state_diagram() -> str:
    """Return the table of states as a Mermaid diagram."""
    inner = [state for state in CellState if "." in state]
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {CellState.PREOPERATIONAL}"]
    lines += [f"    state {CellState.SINGLE_EXECUTION} {{", f"        [*] --> {CellState.ACQUIRING.leaf}"]
    both_inside: list[str] = []
    outside: list[str] = []
    for row in TABLE:
        for source in row.sources:
            line = f"{source.leaf} --> {row.destination.leaf}: {row.event}"
            if source in inner and row.destination in inner:
                both_inside.append(f"        {line}")
            else:
                outside.append(f"    {line}")
    return "\n".join([*lines, *both_inside, "    }", *outside, "```"]) + "\n"


def states_page() -> str:
    """Return the page of states, events and conditions."""
    rows = [f"| `{row.event}` | {_code(row.sources)} | `{row.destination}` | {row.meaning} |" for row in TABLE]
    steps = [
        f"| `{state}` | {_code(after for after in OfferState if after in allowed) or 'nothing: settled'} |"
        for state, allowed in STEPS.items()
    ]
    return "\n".join(
        [
            "# States",
            "",
            NOTE.strip(),
            "",
            "The names are those of OPC 40100-1 (machine vision). An event that has no line here for the present",
            "state is refused, and the refusal names what is possible. Every transition is logged with its cause.",
            "Software is not a safety function: no state here replaces an emergency stop.",
            "",
            state_diagram(),
            "| event | in | leads to | when |",
            "| --- | --- | --- | --- |",
            *rows,
            "",
            "## Conditions",
            "",
            "Beside the state stand two conditions, as PackML has them. They say why the cell does not get on; they",
            "change no state.",
            "",
            f"- *held*, a cause of our own: {_code(HeldCause)}.",
            f"- *suspended*, a cause outside of the cell: {_code(SuspendedCause)}.",
            "",
            "## A result in the ledger",
            "",
            "| from | to |",
            "| --- | --- |",
            *steps,
            "",
        ]
    )


def errors_page(entries: Iterable[Entry]) -> str:
    """Return the page of the error catalogue."""
    lines = [
        "# Errors",
        "",
        NOTE.strip(),
        "",
        "Every error has a number. Code, robot display and this page read the same file, `config/errors.toml`.",
        "",
    ]
    ends = {
        Clears.ITSELF: "It goes by itself when the cause is gone.",
        Clears.ACKNOWLEDGE: "It stands until a person acknowledges it.",
        Clears.RESTART: "It stands until the cell is started again.",
    }
    category = ""
    for item in entries:
        if item.category != category:
            category = item.category
            lines += [f"## {category.capitalize()}", ""]
        lines += [
            f"### {item.number} {item.title}",
            "",
            f"{item.meaning}",
            "",
            f"**What to do.** {item.action} {ends[item.clears]}",
            "",
            f"Priority {item.priority}. The robot shows: `{item.robot}`",
            "",
        ]
    return "\n".join(lines)


def faults_page() -> str:
    """Return the page of the fault matrix."""
    rows = tomllib.loads((DOCS / "reference" / "faults.toml").read_text(encoding="utf-8"))["row"]
    lines = [
        "# Faults",
        "",
        NOTE.strip(),
        "",
        "What can go wrong, how the cell notices, what it does, which [number](errors.md) a person sees, and the tests",
        "that make it happen and look. The rows stand in `faults.toml`; a test fails if one has no test.",
        "",
        "| fault | notices by | does | number | tests |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        numbers = ", ".join(str(number) for number in row["numbers"]) or "none"
        tests = "<br>".join(f"`{test}`" for test in row["tests"])
        lines.append(f"| {row['fault']} | {row['notices']} | {row['does']} | {numbers} | {tests} |")
    return "\n".join([*lines, ""])


def actions_page() -> str:
    """Return the page that says how the control API and the command line do what the pages do."""
    rows = tomllib.loads((DOCS / "reference" / "pages.toml").read_text(encoding="utf-8"))["row"]
    least = {f"{route.method} {route.path}": route.role for page in PAGES for route in page.routes}
    lines = [
        "# What the pages do, by API and command",
        "",
        NOTE.strip(),
        "",
        "Everything that a page of the [HMI](../how-to/hmi.md) does, the [control API](control-api.md) and the command",
        "line do too. The rows stand in `pages.toml`; a test holds them against the routes of the pages, the requests",
        "in their code, and the verbs of the command. *Role* is the least that may do it on the pages.",
        "",
        "| page | what | role | control API | command |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        roles = sorted({role for route in row["routes"] if (role := least[route]) is not None})
        said = ", ".join(role.word for role in roles) or "none"
        api = "<br>".join(f"`{request}`" for request in row["api"]) or "none: it is the pages' own"
        commands = "<br>".join(f"`slabcell {command}`" for command in row["commands"])
        lines.append(f"| {row['page']} | {row['does']} | {said} | {api} | {commands} |")
    return "\n".join([*lines, ""])


def exactly_once_page() -> str:
    """Return the page of what happens after a lost link, computed by asking the rules themselves."""
    lines = [
        "# After a lost link",
        "",
        NOTE.strip(),
        "",
        "A result is acted on at most once, and no slab gets lost without a record. Whatever the robot may act on is",
        "in the ledger before the robot hears of it; every acknowledgement is in the ledger before it is answered;",
        "result ids strictly increase over restarts of the cell. The robot writes its last result and how far it got",
        "into its own memory before the physical act, and tells both, with what its gripper feels, when it greets the",
        "cell again. This table says what the cell then does with a result that was under way.",
        "",
        "| ledger | robot | gripper | result becomes | then |",
        "| --- | --- | --- | --- | --- |",
    ]
    for ledger in (OfferState.OFFERED, OfferState.ACCEPTED, OfferState.GRASPED):
        for robot in AckState:
            for holds in (False, True):
                decision = reconcile(ledger, robot, holds_part=holds)
                said = "does not know it" if robot is AckState.NONE else robot.name.lower().replace("_", " ")
                gripper = "part" if holds else "empty"
                lines.append(f"| {ledger} | {said} | {gripper} | {decision.state} | {_then(decision)} |")
    return "\n".join([*lines, ""])


def resources_table() -> str:
    """Return the resources of the control API and the kinds of its events, as tables."""
    rows = [f"| `{item.method} {item.path}` | {item.summary} | {_answer(item.answer)} |" for item in ENDPOINTS]
    kinds = [f"| `{kind}` | {words} |" for kind, words in KINDS.items()]
    resources = ["| request | what it is | answer |", "| --- | --- | --- |", *rows, ""]
    return "\n".join([*resources, "| event | when |", "| --- | --- |", *kinds, ""])


def config_table(model: type[BaseModel]) -> str:
    """Return every key of the configuration as a table: default, limits, what it is, and when a change counts."""
    lines = ["| key | default | limits | what it is | a change counts |", "| --- | --- | --- | --- | --- |"]
    for key, field in _config_keys(model, ""):
        default = "required" if field.is_required() else f"`{json.dumps(field.get_default(), default=str)}`"
        limits = ", ".join(sorted(_limit(item) for item in field.metadata if _limit(item)))
        when = "at a reload" if is_reloadable(key) else "at a restart"
        lines.append(f"| `{key}` | {default} | {limits} | {field.description or ''} | {when} |")
    return "\n".join([*lines, ""])


def _config_keys(model: type[BaseModel], above: str) -> Iterable[tuple[str, FieldInfo]]:
    for name, field in model.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel) and inner is not FrameConfig:
            yield from _config_keys(inner, f"{above}{name}.")
        else:
            yield f"{above}{name}", field


def _limit(item: object) -> str:
    signs = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<", "min_length": "length ≥", "max_length": "length ≤"}
    return next((f"{sign} {getattr(item, name)}" for name, sign in signs.items() if hasattr(item, name)), "")


def _json(document: dict[str, object]) -> str:
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _answer(answer: type | str) -> str:
    return f"`{answer}`" if isinstance(answer, str) else f"`{answer.__name__}`"


def _code(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def _then(decision: Decision) -> str:
    if decision.resume:
        return "the same place pose again, no new pick"
    if decision.fault is not None:
        return f"alarm {int(decision.fault)}: {decision.reason}"
    return decision.reason


def _between_marks(text: str, name: str, content: str) -> str:
    begin = f"<!-- generated: {name}, by docs/generate.py -->"
    head, _, rest = text.partition(begin)
    _, _, tail = rest.partition(END)
    return f"{head}{begin}\n\n{content}\n{END}{tail}"


def main(arguments: list[str] | None = None) -> int:
    """Write the pages, or compare them; return the exit code."""
    parser = argparse.ArgumentParser(description="write the pages that are drawn from the code")
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit 1 if a page is not what the code says"
    )
    check = parser.parse_args(arguments).check
    stale = 0
    for path, content in pages().items():
        if path.exists() and path.read_text(encoding="utf-8") == content:
            continue
        stale += 1
        if check:
            sys.stderr.write(f"{path}: is not what the code says; run: python docs/generate.py\n")
        else:
            path.write_text(content, encoding="utf-8")
            sys.stderr.write(f"wrote {path}\n")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
