"""The verbs of `slabcell vision` for many pictures: sets, keep, forget, run."""

from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

import typer
from rich.table import Table

from slabcell.cli.talk import AsJson, Socket, client, make_console, print_json
from slabcell.cli.vision import Base, Everywhere, PictureName, RecipeFile, candidate, chosen_picture, vision_app
from slabcell.errors import UsageError
from slabcell.service.api.client import ApiClient

__all__ = ["vision_app"]

SetName = Annotated[str, typer.Argument(metavar="SET", help="A set of pictures, as `slabcell vision sets` shows them.")]


@vision_app.command("sets")
def sets_command(
    recipe: Annotated[
        str | None,
        typer.Option("--recipe", metavar="NAME", help="Whose graded pictures; the default is the active one."),
    ] = None,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """List the pictures to try parameters on: kept sets, graded pictures, the last cycles."""
    document = client(socket).get("/v1/vision/sets", **({"recipe": recipe} if recipe else {}))
    if as_json:
        print_json(document)
        return
    for item in document["sets"]:
        for picture in item["pictures"]:
            typer.echo(picture["picture"])


@vision_app.command("keep")
def keep_command(
    set_name: SetName,
    picture: PictureName = "latest",
    name: Annotated[str, typer.Option("--name", metavar="NAME", help="What people call it.")] = "",
    socket: Socket = None,
) -> None:
    """Keep a picture in a set to tune on; print what it is called."""
    api = client(socket)
    said = {"picture": chosen_picture(api, picture), "name": name}
    typer.echo(api.post(f"/v1/vision/sets/{quote(set_name, safe='')}/keep", said)["picture"])


@vision_app.command("forget")
def forget_command(
    picture: Annotated[str, typer.Argument(metavar="PICTURE", help="set:SET/FILE, as `sets` shows it.")],
    socket: Socket = None,
) -> None:
    """Remove a picture from its set."""
    set_name, slash, file = picture.removeprefix("set:").partition("/")
    if not slash:
        msg = f"{picture}: say set:SET/FILE, as `slabcell vision sets` shows it"
        raise UsageError(msg)
    typer.echo(client(socket).post(f"/v1/vision/sets/{quote(set_name, safe='')}/remove", {"file": file})["detail"])


@vision_app.command("run")
def run_command(
    pictures: Annotated[
        list[str],
        typer.Argument(
            metavar="PICTURE...", help="Pictures or files as for preview; set:SET and graded:RECIPE are all."
        ),
    ],
    recipe: RecipeFile = None,
    base: Base = None,
    socket: Socket = None,
    *,
    everywhere: Everywhere = False,
    as_json: AsJson = False,
) -> None:
    """Run the vision on many pictures, with parameters that are not active.  Exit code 1 if one is refused."""
    api = client(socket)
    names = [name for word in pictures for name in _named(api, word)]
    body: dict[str, Any] = {**candidate(recipe, base), "pictures": names, "everywhere": everywhere}
    done = api.follow(api.post("/v1/vision/run", body))
    if as_json:
        print_json(done)
    else:
        _show(done)
    if any(row["refusal"] for row in done["pictures"]):
        raise typer.Exit(1)


def _named(api: ApiClient, word: str) -> list[str]:
    """Return the pictures that a word means: all of a set, or one."""
    kind, _, name = word.partition(":")
    if "/" in name or kind not in ("set", "graded") or Path(word).exists():
        return [chosen_picture(api, word)]
    wanted = {"set": "stored", "graded": "graded"}[kind]
    query = {"recipe": name} if kind == "graded" else {}
    sets = api.get("/v1/vision/sets", **query)["sets"]
    found = [
        item["picture"] for one in sets if (one["kind"], one["name"]) == (wanted, name) for item in one["pictures"]
    ]
    if not found:
        msg = f"{word}: there are no such pictures; `slabcell vision sets` lists what is there"
        raise UsageError(msg)
    return found


def _show(done: dict[str, Any]) -> None:
    table = Table("picture", "slots", "refused", "worst residual mm", "ms", "problem")
    for row in done["pictures"]:
        worst = row["worst_residual_mm"]
        table.add_row(
            row["picture"],
            " ".join(map(str, row["slots"])),
            " ".join(row["rejected"]),
            "" if worst is None else f"{worst:.3f}",
            f"{row['timing_ms'].get('total', 0.0):.1f}",
            row["refusal"],
        )
    make_console().print(table)
