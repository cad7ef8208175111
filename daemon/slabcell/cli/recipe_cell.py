"""The verbs of `slabcell recipe` that talk to a running cell: list, show, schema, diff, save."""

import json
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote, urlencode

import typer
from rich.table import Table

from slabcell.cli.files import read_file
from slabcell.cli.talk import AsJson, Socket, client, make_console, print_json
from slabcell.cli.vision import candidate
from slabcell.service.api.client import ApiClient

__all__ = ["activate_running", "add_running_verbs", "path_of", "verify_running"]

Name = Annotated[str, typer.Argument(metavar="NAME", help="A recipe of the running cell.")]


def path_of(name: str, *rest: str) -> str:
    """Return the resource of a recipe."""
    return "/".join(["/v1/recipes", quote(name, safe="~"), *rest])


def list_command(socket: Socket = None, *, as_json: AsJson = False) -> None:
    """List the recipes of the running cell, saved versions too."""
    document = client(socket).get("/v1/recipes")
    if as_json:
        print_json(document)
        return
    table = Table("recipe", "active", "slots", "sha256", "problem")
    for item in document["recipes"]:
        active = "active" if item["active"] else ""
        table.add_row(item["name"], active, str(item["slots"]), item["sha256"][:12], item["problem"])
    make_console().print(table)


def show_command(name: Name, socket: Socket = None, *, as_json: AsJson = False) -> None:
    """Show a recipe of the running cell as it is written; with --json every value and its template."""
    document = client(socket).get(path_of(name))
    if as_json:
        print_json(document)
    else:
        typer.echo(document["toml"], nl=not document["toml"].endswith("\n"))


def schema_command(socket: Socket = None) -> None:
    """Print the JSON schema of recipes: types, ranges, units and help."""
    typer.echo(json.dumps(client(socket).get("/v1/recipes/schema")["json_schema"], indent=1))


def save_command(
    name: Name,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The parameters, as a recipe file has them.")],
    template: Annotated[
        Path | None, typer.Option("--template", metavar="CSV", help="Another template than that of NAME.")
    ] = None,
    new: Annotated[
        str | None, typer.Option("--as", metavar="NEW", help="Save it as a new recipe of this name, not as a version.")
    ] = None,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Save parameters as a new version of a recipe on the running cell, or as a new one.  It is not active yet."""
    body: dict[str, Any] = {"toml": read_file(file).decode("utf-8", "replace")}
    if new is not None:
        body["name"] = new
    if template is not None:
        body["template_csv"] = read_file(template).decode("utf-8", "replace")
    document = client(socket).post(path_of(name, "versions"), body)
    if as_json:
        print_json(document)
    else:
        typer.echo(document["name"])


def template_command(
    name: Name,
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="A CSV file or DXF drawing instead of the recipe's template.")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of a drawing that names none.")] = None,
    layer: Annotated[list[str] | None, typer.Option(help="Layer of the slabs in a drawing; repeatable.")] = None,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Say what the running cell finds about a recipe's template, or about a file with this recipe's gripper."""
    if file is None:
        document = client(socket).get(path_of(name, "template"))
    else:
        query = urlencode({"recipe": name, "layers": ",".join(layer or ()), **({"unit": unit} if unit else {})})
        content, media_type = read_file(file), "application/octet-stream"
        document = client(socket).send(f"/v1/templates/check?{query}", content, media_type)
    if as_json:
        print_json(document)
        return
    typer.echo(f"{len(document['slots'])} slots; {'it can be used' if document['usable'] else 'it cannot be used'}")
    for item in document["findings"]:
        place = f"{item['place']}: " if item["place"] else ""
        typer.echo(f"{'note ' if item['advice'] else 'fault'} {place}{item['text']}")


def diff_command(
    name: Name,
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="Parameters over those of NAME, as a recipe file has them.")
    ] = None,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Say in what a recipe, or parameters over it, differ from the active recipe of the running cell."""
    document = client(socket).post("/v1/recipes/compare", candidate(file, name))
    if as_json:
        print_json(document)
        return
    if document["template_changed"]:
        typer.echo("the template is another one")
    table = Table("parameter", document["active"], name if file is None else str(file), "unit")
    for item in document["changes"]:
        table.add_row(item["key"], json.dumps(item["active"]), json.dumps(item["candidate"]), item["unit"])
    make_console().print(table)


def verify_running(api: ApiClient, name: str) -> dict[str, Any]:
    """Have the running cell run the graded set of one of its recipes; return what came of it."""
    return api.follow(api.post(path_of(name, "verify")))


def activate_running(api: ApiClient, name: str) -> str:
    """Make a recipe of the running cell its active one; return what was done."""
    return str(api.post(path_of(name, "activate"))["detail"])


def add_running_verbs(app: typer.Typer) -> None:
    """Add the verbs to `slabcell recipe`."""
    app.command("list")(list_command)
    app.command("show")(show_command)
    app.command("schema")(schema_command)
    app.command("diff")(diff_command)
    app.command("save")(save_command)
    app.command("template")(template_command)
