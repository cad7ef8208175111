"""Small promptable models with the tensors of the real ones.

They answer a prompt with what is light in the prompt's box, or, asked by a point alone, with what is light on the
point's side of the picture's middle.  Their alternatives mislead: the whole light area with the best score, then the
slab, then half of it.  The encoder keeps the picture in the embedding: sixteen by sixteen pixels in 256 channels.
"""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

LEVEL = 105.0
FIRMNESS = 0.3  # logits a grey level
SCORES = [0.99, 0.5, 0.95]

FLOAT, INT64 = TensorProto.FLOAT, TensorProto.INT64
EMBEDDING = (1, 256, 64, 64)


class Graph:
    """Writes one model, operation by operation."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self._inputs: list[onnx.ValueInfoProto] = []
        self._outputs: list[onnx.ValueInfoProto] = []

    def input(self, name: str, shape, kind: int = FLOAT) -> str:
        self._inputs.append(helper.make_tensor_value_info(name, kind, shape))
        return name

    def constant(self, values, dtype=np.float32) -> str:
        name = f"constant{len(self._constants)}"
        self._constants.append(numpy_helper.from_array(np.asarray(values, dtype), name))
        return name

    def op(self, kind: str, *inputs: str, out: str = "", **attributes) -> str:
        name = out or f"{kind.lower()}{len(self._nodes)}"
        self._nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def output(self, source: str, name: str, shape) -> None:
        self.op("Identity", source, out=name)
        self._outputs.append(helper.make_tensor_value_info(name, FLOAT, shape))

    def save(self, path: Path) -> Path:
        graph = helper.make_graph(self._nodes, "test", self._inputs, self._outputs, self._constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        onnx.save(model, str(path))
        return path


def _grey(g: Graph, picture: str) -> str:
    return g.op("ReduceMean", picture, axes=[1], keepdims=1)


def _embed(g: Graph, grey: str) -> str:
    return g.op("SpaceToDepth", grey, blocksize=16)


def _normalised(g: Graph, picture: str) -> str:
    """(n, 3, h, w) of 0 ... 255 as Segment Anything wants it."""
    mean = g.constant(np.array([123.675, 116.28, 103.53]).reshape(1, 3, 1, 1))
    deviation = g.constant(np.array([58.395, 57.12, 57.375]).reshape(1, 3, 1, 1))
    return g.op("Div", g.op("Sub", picture, mean), deviation)


def _from_normalised(g: Graph, grey: str) -> str:
    return g.op("Add", g.op("Mul", grey, g.constant(57.63)), g.constant(114.5))


def sam_encoder(path: Path, *, name: str = "input_image", side: int = 1024, embedding=EMBEDDING) -> Path:
    g = Graph()
    picture = g.input(name, (1, 3, side, side))
    blocks = g.op("SpaceToDepth", _grey(g, picture), blocksize=side // embedding[2])
    if embedding[1] != 256:
        blocks = g.op("Slice", blocks, *(g.constant([v], np.int64) for v in (0, embedding[1], 1)))
    g.output(blocks, "image_embeddings", embedding)
    return g.save(path)


def sam_encoder_with_preprocessing(path: Path) -> Path:
    g = Graph()
    picture = g.input("input_image", ("image_height", "image_width", 3))
    planes = g.op("Unsqueeze", g.op("Transpose", picture, perm=[2, 0, 1]), g.constant([0], np.int64))
    normal = _normalised(g, planes)
    # Padded to the right and below, after normalising, as the real one does.
    size = g.op("Slice", g.op("Shape", normal), *(g.constant([v], np.int64) for v in (2, 4, 0)))
    pads = g.op(
        "Concat",
        g.constant([0] * 6, np.int64),
        g.op("Sub", g.constant([1024, 1024], np.int64), size),
        axis=0,
    )
    padded = g.op("Pad", normal, pads)
    g.output(_embed(g, _grey(g, padded)), "image_embeddings", EMBEDDING)
    return g.save(path)


def sam2_encoder(path: Path) -> Path:
    g = Graph()
    grey = _grey(g, g.input("image", (1, 3, 1024, 1024)))
    for name, channels, size in (("high_res_feats_0", 32, 256), ("high_res_feats_1", 64, 128)):
        step = 1024 // size
        pooled = g.op("AveragePool", grey, kernel_shape=[step, step], strides=[step, step])
        g.output(
            g.op("Expand", pooled, g.constant([1, channels, size, size], np.int64)), name, (1, channels, size, size)
        )
    g.output(_embed(g, grey), "image_embed", EMBEDDING)
    return g.save(path)


def _column(g: Graph, coords: str, axis: int) -> str:
    """One coordinate of the points: (..., n, 2) -> (..., n)."""
    return g.op("Gather", coords, g.constant(axis, np.int64), axis=-1)


def _labelled(g: Graph, values: str, labels: str, label: float, otherwise: float, reduce: str) -> str:
    """The least or greatest of the values whose label is this, (..., 1)."""
    here = g.op("Equal", labels, g.constant(label))
    return g.op(reduce, g.op("Where", here, values, g.constant(otherwise)), axes=[-1], keepdims=1)


def _answers(g: Graph, grey: str, x: str, y: str, coords: str, labels: str, middle: str) -> str:
    """Logits of the alternatives, (prompts, 3, h, w), for coords (prompts, n, 2) and labels (prompts, n).

    ``grey`` (1, 1, h, w) in 0 ... 255; ``x`` (1, 1, 1, w), ``y`` (1, 1, h, 1): where its cells are.
    """
    light = g.op("Mul", g.op("Sub", grey, g.constant(LEVEL)), g.constant(FIRMNESS))
    across, down = _column(g, coords, 0), _column(g, coords, 1)
    far, axes = 1e5, g.constant([2, 3], np.int64)
    corners = [
        g.op("Unsqueeze", _labelled(g, values, labels, label, otherwise, reduce), axes)
        for values, label, otherwise, reduce in (
            (across, 2.0, far, "ReduceMin"),
            (down, 2.0, far, "ReduceMin"),
            (across, 3.0, -far, "ReduceMax"),
            (down, 3.0, -far, "ReduceMax"),
        )
    ]
    corners = [g.op("Reshape", corner, g.constant([-1, 1, 1, 1], np.int64)) for corner in corners]
    left, top, right, bottom = corners
    boxed = g.op("Less", left, g.constant(far))
    inside = g.op(
        "And",
        g.op("And", g.op("GreaterOrEqual", x, left), g.op("LessOrEqual", x, right)),
        g.op("And", g.op("GreaterOrEqual", y, top), g.op("LessOrEqual", y, bottom)),
    )
    point = g.op("Reshape", _labelled(g, across, labels, 1.0, -far, "ReduceMax"), g.constant([-1, 1, 1, 1], np.int64))
    side = g.op("Equal", g.op("Less", x, middle), g.op("Less", point, middle))
    alone = g.op("And", g.op("Not", boxed), g.op("And", side, g.op("LessOrEqual", y, g.constant(far))))
    here = g.op("Or", g.op("And", boxed, inside), alone)
    nothing = g.constant(-12.0)
    slab = g.op("Where", here, light, nothing)
    half = g.op("Where", g.op("Less", x, point), slab, nothing)
    whole = g.op("Add", light, g.op("Mul", slab, g.constant(0.0)))
    return g.op("Concat", whole, slab, half, axis=1)


def _sam_logits(g: Graph, embedding: str, coords: str, labels: str) -> str:
    grey = _from_normalised(g, g.op("DepthToSpace", embedding, blocksize=16, mode="DCR"))
    small = g.op("AveragePool", grey, kernel_shape=[4, 4], strides=[4, 4])
    cells = (np.arange(256) + 0.5) * 4 - 0.5
    x, y = g.constant(cells.reshape(1, 1, 1, 256)), g.constant(cells.reshape(1, 1, 256, 1))
    return _answers(g, small, x, y, coords, labels, g.constant(511.5))


def _masks_taken(g: Graph) -> str:
    """What the inputs for an earlier mask add: nothing."""
    mask = g.input("mask_input", (1, 1, 256, 256))
    has = g.input("has_mask_input", (1,))
    return g.op("Mul", g.op("Mul", g.op("ReduceMean", mask, keepdims=0), has), g.constant(0.0))


def sam_decoder(path: Path, *, low_res: bool = True, embedding=EMBEDDING, scale: float = 1.0) -> Path:
    g = Graph()
    embedded = g.input("image_embeddings", embedding)
    coords = g.input("point_coords", (1, "num_points", 2))
    labels = g.input("point_labels", (1, "num_points"))
    nothing = _masks_taken(g)
    size = g.input("orig_im_size", (2,))
    logits = g.op("Mul", g.op("Add", _sam_logits(g, embedded, coords, labels), nothing), g.constant(scale))
    big = g.op("Resize", logits, "", "", g.constant([1, 3, 1024, 1024], np.int64), mode="linear")
    ends = g.op("Cast", size, to=INT64)
    masks = g.op("Slice", big, g.constant([0, 0], np.int64), ends, g.constant([2, 3], np.int64))
    g.output(masks, "masks", (1, 3, "h", "w"))
    g.output(g.constant([SCORES]), "iou_predictions", (1, 3))
    if low_res:
        g.output(logits, "low_res_masks", (1, 3, 256, 256))
    return g.save(path)


def sam2_decoder(path: Path) -> Path:
    g = Graph()
    embedded = g.input("image_embed", EMBEDDING)
    features = [g.input("high_res_feats_0", (1, 32, 256, 256)), g.input("high_res_feats_1", (1, 64, 128, 128))]
    coords = g.input("point_coords", ("num_labels", "num_points", 2))
    labels = g.input("point_labels", ("num_labels", "num_points"))
    nothing = _masks_taken(g)
    for feature in features:
        nothing = g.op("Add", nothing, g.op("Mul", g.op("ReduceMean", feature, keepdims=0), g.constant(0.0)))
    g.output(g.op("Add", _sam_logits(g, embedded, coords, labels), nothing), "masks", (1, 3, 256, 256))
    g.output(g.constant([SCORES]), "iou_predictions", (1, 3))
    return g.save(path)


def _range(g: Graph, count: str, shape: list[int]) -> str:
    numbers = g.op("Range", g.constant(0, np.int64), count, g.constant(1, np.int64))
    return g.op("Reshape", g.op("Cast", numbers, to=FLOAT), g.constant(shape, np.int64))


def _efficient_answers(g: Graph, grey: str, height: str, width: str, coords: str, labels: str) -> str:
    x, y = _range(g, width, [1, 1, 1, -1]), _range(g, height, [1, 1, -1, 1])
    middle = g.op("Mul", g.op("Sub", g.op("Cast", width, to=FLOAT), g.constant(1.0)), g.constant(0.5))
    one = g.constant([0], np.int64)
    flat = g.op("Squeeze", coords, one), g.op("Squeeze", labels, one)
    return g.op("Unsqueeze", _answers(g, grey, x, y, *flat, middle), one)


def efficient(path: Path, *, queries: int | str = "num_queries", points: int | str = "num_pts") -> Path:
    """EfficientSAM in one file.  Its own export leaves either the prompts open or the points of one, not both."""
    g = Graph()
    picture = g.input("batched_images", ("batch", 3, "height", "width"))
    coords = g.input("batched_point_coords", ("batch", queries, points, 2))
    labels = g.input("batched_point_labels", ("batch", queries, points))
    size = g.op("Shape", picture)
    height, width = (g.op("Gather", size, g.constant(axis, np.int64)) for axis in (2, 3))
    grey = g.op("Mul", _grey(g, picture), g.constant(255.0))
    masks = _efficient_answers(g, grey, height, width, coords, labels)
    g.output(masks, "output_masks", ("batch", "num_queries", 3, "height", "width"))
    g.output(g.constant([[SCORES]]), "iou_predictions", (1, 1, 3))
    return g.save(path)


def efficient_encoder(path: Path) -> Path:
    g = Graph()
    picture = g.input("batched_images", ("batch", 3, "height", "width"))
    square = g.op("Resize", picture, "", "", g.constant([1, 3, 1024, 1024], np.int64), mode="linear")
    g.output(_embed(g, _grey(g, square)), "image_embeddings", ("batch", 256, 64, 64))
    return g.save(path)


def efficient_decoder(path: Path) -> Path:
    g = Graph()
    embedded = g.input("image_embeddings", ("batch", 256, 64, 64))
    coords = g.input("batched_point_coords", ("batch", "num_queries", "num_points", 2))
    labels = g.input("batched_point_labels", ("batch", "num_queries", "num_points"))
    size = g.input("orig_im_size", (2,), INT64)
    grey = g.op("Mul", g.op("DepthToSpace", embedded, blocksize=16, mode="DCR"), g.constant(255.0))
    sizes = g.op("Concat", g.constant([1, 1], np.int64), size, axis=0)
    own = g.op("Resize", grey, "", "", sizes, mode="linear")
    height, width = (g.op("Gather", size, g.constant(axis, np.int64)) for axis in (0, 1))
    masks = _efficient_answers(g, own, height, width, coords, labels)
    g.output(masks, "output_masks", ("batch", "num_queries", 3, "h", "w"))
    g.output(g.constant([[SCORES]]), "iou_predictions", (1, 1, 3))
    g.output(masks, "low_res_logits", ("batch", "num_queries", 3, "h", "w"))
    return g.save(path)


def other_model(path: Path) -> Path:
    """A network that is no promptable model: a picture in, ten classes out."""
    g = Graph()
    picture = g.input("data", (1, 3, 224, 224))
    pooled = g.op("ReduceMean", picture, axes=[1, 2, 3], keepdims=0)
    scores = g.op("Mul", g.op("Unsqueeze", pooled, g.constant([1], np.int64)), g.constant(np.ones((1, 10))))
    g.output(scores, "scores", (1, 10))
    second = g.op("Identity", scores)
    g.output(second, "more", (1, 10))
    return g.save(path)
