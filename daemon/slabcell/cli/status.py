"""`slabcell status`: how is the running cell?"""

from typing import Any

import typer
from rich.console import Console
from rich.table import Table

from slabcell.cli.talk import AsJson, Socket, client, make_console, print_json, seconds

__all__ = ["status_command"]

_ENDS = {0: "done", 1: "job complete", 2: "nothing left to offer"}
"""How a cycle ends that has no fault; what another code means stands in the error catalogue."""


def status_command(socket: Socket = None, *, as_json: AsJson = False) -> None:
    """Show how the running cell is: state, links, job, last cycle, and the most urgent alarm."""
    status = client(socket).get("/v1/status")
    if as_json:
        print_json(status)
        return
    console = make_console()
    because = ", ".join(f"{word}: {status[word]}" for word in ("held", "suspended") if status[word])
    console.print(f"{status['name']}: {status['state']}{f' ({because})' if because else ''}", style="bold")
    console.print(f"slabcell {status['version']}, up for {seconds(status['uptime_s'])}, recipe {status['recipe']}")
    _print_links(console, status)
    _print_job(console, status["job"])
    _print_cycle(console, status["cycle"])
    alarm = status["highest_alarm"]
    if alarm:
        console.print(f"{alarm['number']} {alarm['title']}: {alarm['detail']}", style="bold red")
        console.print(f"  {alarm['action']}")
        if status["alarms"] > 1:
            console.print(f"  and {status['alarms'] - 1} more: slabcell alarms list")
    if status["pending_reload"]:
        console.print(f"changed, needs a restart: {', '.join(status['pending_reload'])}", style="yellow")


def _print_links(console: Console, status: dict[str, Any]) -> None:
    table = Table("link", "state", "for", "detail")
    for link in status["links"]:
        style = {"up": "", "connecting": "yellow", "down": "bold red"}[link["state"]]
        table.add_row(link["name"], link["state"], seconds(link["age_s"]), link["detail"], style=style)
    console.print(table)


def _print_job(console: Console, job: dict[str, Any] | None) -> None:
    if job is None:
        console.print("no job: one begins with the robot's next trigger")
        return
    slots = job["slots"]
    console.print(f"job {job['job']} ({job['state']}): {len(slots['laid'])} of {slots['total']} slots are laid")
    for name, words in (("under_way", "under way"), ("unknown", "unknown"), ("given_up", "given up")):
        if slots[name]:
            console.print(f"  {words}: slots {', '.join(map(str, slots[name]))}")


def _print_cycle(console: Console, cycle: dict[str, Any] | None) -> None:
    if cycle is None:
        return
    times = "  ".join(f"{stage} {ms:.0f} ms" for stage, ms in cycle["times_ms"].items())
    what = "verification" if cycle["verification"] else f"{cycle['found']} found, {len(cycle['offers'])} offered"
    console.print(f"last cycle: {_ENDS.get(cycle['code']) or cycle['message'] or cycle['code']}, {what}")
    typer.echo(f"  {times}")
