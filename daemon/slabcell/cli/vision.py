"""`slabcell vision`: what would the running cell's vision make of a picture with other parameters?"""

from pathlib import Path
from typing import Annotated, Any

import typer

from slabcell.cli.files import read_file, write_file
from slabcell.cli.talk import AsJson, Socket, client, print_json, print_parts
from slabcell.service.api.client import ApiClient

__all__ = ["Base", "Everywhere", "PictureName", "RecipeFile", "candidate", "chosen_picture", "vision_app"]

vision_app = typer.Typer(no_args_is_help=True)

PictureName = Annotated[
    str,
    typer.Option(
        "--picture",
        metavar="PICTURE",
        help="live (taken now), latest, cycle:NUMBER, set:SET/FILE, graded:RECIPE/FILE, or a PNG, JPEG or TIFF file.",
    ),
]
RecipeFile = Annotated[
    Path | None, typer.Option("--recipe", metavar="FILE", help="Parameters to try, as a recipe file has them.")
]
Base = Annotated[str | None, typer.Option("--base", metavar="NAME", help="The cell's recipe that they are over.")]
Everywhere = Annotated[bool, typer.Option("--everywhere", help="Look beyond the pick area.")]
KEPT = ("cycle:", "upload:", "set:", "graded:")


@vision_app.callback()
def _group() -> None:
    """Try parameters of the vision on a running cell."""


@vision_app.command("preview")
def preview_command(
    recipe: RecipeFile = None,
    base: Base = None,
    picture: PictureName = "latest",
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Write what the vision passed by into this folder.")
    ] = None,
    socket: Socket = None,
    *,
    everywhere: Everywhere = False,
    as_json: AsJson = False,
) -> None:
    """Run the vision on a picture, with parameters that are not active.  Nothing changes in the cell.

    Exit code 1 if the picture is refused.
    """
    api = client(socket)
    body = {**candidate(recipe, base), "picture": chosen_picture(api, picture), "everywhere": everywhere}
    done = api.post("/v1/vision/preview", body)
    written = _write(api, done, out) if out is not None else []
    if as_json:
        print_json({**done, "files": written})
    else:
        _show(done)
        for name in written:
            typer.echo(name)
    if done["refusal"]:
        raise typer.Exit(1)


def candidate(recipe: Path | None, base: str | None) -> dict[str, Any]:
    """Return a recipe that somebody is working on, as requests have it."""
    known = {"base": base}
    return known if recipe is None else {**known, "toml": read_file(recipe).decode("utf-8", "replace")}


def chosen_picture(api: ApiClient, name: str) -> str:
    """Return how the daemon calls a picture; ``live`` takes one, a file is uploaded."""
    if name == "live":
        api.post("/v1/frames/take")
        return "latest"
    if name == "latest" or name.startswith(KEPT):
        return name
    return str(api.send("/v1/vision/pictures", read_file(Path(name)), "image/png")["picture"])


def _write(api: ApiClient, done: dict[str, Any], out: Path) -> list[str]:
    files: list[str] = []
    for buffer in done["buffers"]:
        path = out / buffer["name"]
        write_file(path, api.fetch(buffer["path"]).content)
        files.append(str(path))
    return files


def _show(done: dict[str, Any]) -> None:
    located = done["located"]
    if located is None:
        typer.echo(f"{done['picture']}: refused: {done['refusal']}")
        return
    print_parts(located)
    typer.echo(f"{done['recipe']}: {done['segmentation']}")
    stages = ", ".join(f"{name} {value:.1f}" for name, value in located["timing_ms"].items())
    typer.echo(f"milliseconds on the bench, at low priority: {stages}")
