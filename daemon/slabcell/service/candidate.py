"""What would a recipe be that somebody is working on?  Parameters as TOML or JSON, over a recipe that is there.

A candidate is written nowhere.  It may name no model that the recipe which it is based on does not name: the daemon
opens no file because somebody says so over the API.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

from slabcell.errors import RecipeError
from slabcell.recipe import Recipe, RecipeFile, make_recipe
from slabcell.template import MAX_BYTES, Template, parse_template
from slabcell.toml_file import check, parse_document, read_toml

__all__ = ["Candidate", "make_candidate"]

SOURCE: Final = Path("candidate.toml")
"""What stands in messages in the place of a file."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One recipe as it would be: as it is written, the bytes of its template, and what both make."""

    written: RecipeFile
    template_csv: bytes
    recipe: Recipe


def make_candidate(
    base: Path,
    *,
    toml: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    template_csv: str | None = None,
) -> Candidate:
    """Return the recipe that parameters make, over the recipe of the file ``base``; blocks.

    Without parameters they are those of the base, and so is the template.  Raises RecipeError or TemplateError.
    """
    known = read_toml(base, RecipeFile, RecipeError)
    if toml is not None and parameters is not None:
        msg = "parameters are given twice, as TOML and as an object: choose one"
        raise RecipeError(msg)
    written = known
    if toml is not None:
        document = parse_document(toml.encode(), SOURCE, RecipeError)
        written = check(_with_file(document.content, known), RecipeFile, RecipeError, document.place)
    elif parameters is not None:
        written = check(_with_file(parameters, known), RecipeFile, RecipeError, lambda _: SOURCE.stem)
    _require_known_models(written, known)
    raw = _template_of(base, known) if template_csv is None else template_csv.encode()
    template: Template = parse_template(raw, "the template", name=Path(known.template.file).stem)
    return Candidate(written, raw, make_recipe(base.stem, written, template, base.parent))


def _with_file(content: Mapping[str, Any], known: RecipeFile) -> dict[str, Any]:
    """Fill in the template's file, which a candidate need not name."""
    template = content.get("template", {})
    if not isinstance(template, Mapping):
        return dict(content)
    shown = cast("Mapping[str, Any]", template)
    defaults = {"file": known.template.file, "thickness_mm": known.template.thickness_mm}
    return {**content, "template": {**defaults, **shown}}


def _require_known_models(written: RecipeFile, known: RecipeFile) -> None:
    asked, there = written.segmentation.promptable, known.segmentation.promptable
    if asked is None:
        return
    named = {asked.encoder, asked.decoder} - {None}
    allowed = set[str | None]() if there is None else {there.encoder, there.decoder}
    if not named <= allowed:
        msg = (
            f"segmentation.promptable: model {sorted(map(str, named - allowed))[0]!r:.80} is not one of the recipe"
            " this is based on: name it in the recipe's file first"
        )
        raise RecipeError(msg)


def _template_of(base: Path, known: RecipeFile) -> bytes:
    path = base.parent / known.template.file
    try:
        with path.open("rb") as stream:
            return stream.read(MAX_BYTES + 1)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror} (template of {base})"
        raise RecipeError(msg) from error
