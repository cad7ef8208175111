"""What is drawn over a picture?  The result as JSON, with every outline in pixels of the picture."""

from slabcell.vision.result import LocateResult

__all__ = ["overlay_document"]


def overlay_document(result: LocateResult, image: str) -> dict[str, object]:
    """Return the ``slabcell.locate/1`` object with the outlines, in pixels of the picture, to draw over it."""
    document = result.to_document(image)
    for name, items in (("parts", result.parts), ("rejected", result.rejected)):
        entries: list[dict[str, object]] = document[name]  # pyright: ignore[reportAssignmentType]  (as to_document builds it)
        for entry, item in zip(entries, items, strict=True):
            entry["outline_px"] = [[round(float(u), 2), round(float(v), 2)] for u, v in item.outline_px]
    return document
