"""`slabcell alarms`: what is wrong, and what does a person say to it?"""

from typing import Annotated, Any

import typer
from rich.table import Table

from slabcell.cli.talk import AsJson, Socket, client, given, make_console, print_json, print_page, seconds

__all__ = ["alarms_app"]

alarms_app = typer.Typer(help="Show alarms, and acknowledge or shelve them.", no_args_is_help=True)

Number = Annotated[int, typer.Argument(metavar="NUMBER", help="Number of the alarm.")]


@alarms_app.command("list")
def list_command(
    socket: Socket = None,
    *,
    shelved: Annotated[bool, typer.Option("--shelved", help="Show shelved alarms too.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show the alarms that stand, the most urgent first, and what to do."""
    document = client(socket).get("/v1/alarms", shelved=shelved or not as_json)
    if as_json:
        print_json(document)
        return
    console = make_console()
    shown = [alarm for alarm in document["alarms"] if shelved or not alarm["shelved_s"]]
    if not shown:
        console.print("no alarm")
    if hidden := len(document["alarms"]) - len(shown):
        console.print(f"{hidden} shelved: slabcell alarms list --shelved")
    for alarm in shown:
        style = {"high": "bold red", "medium": "yellow", "low": ""}[alarm["priority"]]
        console.print(f"{alarm['number']} {alarm['title']} ({alarm['priority']})", style=style, highlight=False)
        console.print(f"  for {seconds(alarm['age_s'])}{_remarks(alarm)}: {alarm['detail']}", highlight=False)
        console.print(f"  {alarm['action']}", highlight=False)


def _remarks(alarm: dict[str, Any]) -> str:
    remarks = {
        "its cause is gone": alarm["cause_gone"],
        f"acknowledged by {alarm['acknowledged_by']}": alarm["acknowledged_by"],
        f"shelved for {seconds(alarm['shelved_s'])} more": alarm["shelved_s"],
    }
    return "".join(f", {words}" for words, true in remarks.items() if true)


@alarms_app.command()
def history(
    before: Annotated[int | None, typer.Option("--before", help="Only alarms with an id below this.")] = None,
    limit: Annotated[int, typer.Option("--limit", min=1, max=200, help="At most so many.")] = 50,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Show alarms that came, the newest first."""
    document = client(socket).get("/v1/alarms/history", **given({"limit": limit, "before": before}))
    if as_json:
        print_json(document)
        return
    table = Table("number", "title", "came (UTC)", "went (UTC)", "why")
    for alarm in document["alarms"]:
        table.add_row(str(alarm["number"]), alarm["title"], alarm["came"], alarm["went"] or "stands", alarm["why"])
    print_page(table, document["before"])


@alarms_app.command()
def acknowledge(number: Number, socket: Socket = None) -> None:
    """Say that an alarm is seen; one that waits for a person is cleared by that."""
    typer.echo(client(socket).post(f"/v1/alarms/{number}/acknowledge")["detail"])


@alarms_app.command()
def shelve(
    number: Number,
    minutes: Annotated[float, typer.Option("--minutes", min=0.1, max=480, help="For how long.")] = 30.0,
    socket: Socket = None,
) -> None:
    """Do not show an alarm for a while; it still blocks what it blocks."""
    typer.echo(client(socket).post(f"/v1/alarms/{number}/shelve", {"duration_s": minutes * 60})["detail"])


@alarms_app.command()
def unshelve(number: Number, socket: Socket = None) -> None:
    """Show a shelved alarm again."""
    typer.echo(client(socket).post(f"/v1/alarms/{number}/unshelve")["detail"])
