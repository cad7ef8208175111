"""What does the camera see, and what was found in it?  The newest picture as a file, and its overlay as data."""

from __future__ import annotations

from starlette.responses import Response

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import FrameDocument
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.frames import PictureFormat, Shown, age_s
from slabcell.vision.outlines import overlay_document

__all__ = ["ENDPOINTS", "frame_view", "latest_view"]


def _last(context: ApiContext) -> Shown:
    if context.frames.last is None:
        raise ProblemError(404, "no picture was taken since the daemon started")
    return context.frames.last


def frame_view(context: ApiContext, shown: Shown) -> FrameDocument:
    """Return what is known of a picture."""
    height, width = shown.pixels.shape[:2]
    name = context.frames.id_of(shown)
    return FrameDocument(
        frame=name,
        width=width,
        height=height,
        pixel_format=shown.pixel_format,
        age_s=round(age_s(shown), 3),
        source=shown.source,
        overlay=overlay_document(shown.result, name) if shown.result else None,
    )


def latest_view(context: ApiContext) -> FrameDocument:
    """Return what is known of the newest picture.  Raises ProblemError 404."""
    return frame_view(context, _last(context))


async def _latest(call: Call[ApiContext]) -> FrameDocument:
    return latest_view(call.context)


async def _file(call: Call[ApiContext], kind: PictureFormat) -> Response:
    shown = _last(call.context)
    tag = f'"{call.context.frames.id_of(shown)}"'
    headers = {"etag": tag, "cache-control": "no-cache"}
    if call.request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    content = await call.context.frames.encoded(shown, kind)
    return Response(content, media_type=kind.media_type, headers=headers)


async def _png(call: Call[ApiContext]) -> Response:
    return await _file(call, PictureFormat.PNG)


async def _jpeg(call: Call[ApiContext]) -> Response:
    return await _file(call, PictureFormat.JPEG)


_TAG = "frames"
ENDPOINTS = (
    Endpoint(
        *("GET", "/v1/frames/latest", "The newest picture: size, age, and what was found in it", _latest),
        *(FrameDocument, _TAG),
        problems=(404,),
    ),
    Endpoint(
        *("GET", "/v1/frames/latest.png", "The newest picture, lossless; its ETag is its id", _png),
        *("image/png", _TAG),
        problems=(404,),
    ),
    Endpoint(
        *("GET", "/v1/frames/latest.jpg", "The newest picture, small; its ETag is its id", _jpeg),
        *("image/jpeg", _TAG),
        problems=(404,),
    ),
)
