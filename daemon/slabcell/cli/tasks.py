"""`slabcell task`: what runs beside the running cell, and what came of it?"""

import json
from typing import Annotated

import typer
from rich.table import Table

from slabcell.cli.talk import AsJson, Socket, client, make_console, print_json, seconds

__all__ = ["task_app"]

task_app = typer.Typer(no_args_is_help=True)
Task = Annotated[str, typer.Argument(metavar="TASK", help="Its id, as `slabcell task list` shows it.")]


@task_app.command("list")
def list_command(socket: Socket = None, *, as_json: AsJson = False) -> None:
    """List what runs beside the cell, and what ended lately."""
    document = client(socket).get("/v1/tasks")
    if as_json:
        print_json(document)
        return
    table = Table("task", "what", "state", "steps", "for", "problem")
    for item in document["tasks"]:
        steps = f"{item['done']}/{item['total']}" if item["total"] else ""
        table.add_row(item["task"], item["title"], item["state"], steps, seconds(item["duration_s"]), item["problem"])
    make_console().print(table)


@task_app.command("wait")
def wait_command(task: Task, socket: Socket = None) -> None:
    """Wait for a task, and print what came of it as JSON.  Exit code 1 if it failed."""
    api = client(socket)
    typer.echo(json.dumps(api.follow(api.get(f"/v1/tasks/{task}"))))


@task_app.command("cancel")
def cancel_command(task: Task, socket: Socket = None) -> None:
    """End a task before its time."""
    typer.echo(client(socket).post(f"/v1/tasks/{task}/cancel")["detail"])
