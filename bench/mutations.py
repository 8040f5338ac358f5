"""Whole files, damaged by chance: their bytes, or what they hold, where a check of the bytes would stop all else."""

import io
import json
from collections.abc import Callable
from typing import Any

import numpy as np

Mutate = Callable[[bytes, np.random.Generator], bytes]

WORDS = (
    *("1e400", "-1", "0", "null", "NaN", "[[[[]]]]", '"\\ud800"', "1e-300", "9" * 400, "true", "{}", "3.5", "nan"),
    *("\x1b[2J", "-0.0", "1e308", "\x00", "\ufeff", "0x10", "1_000", "١٢", "inf inf inf"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, -1, 0, 1, 7, 1 << 31, 1 << 63, 10**400, -0.5, 1e-300, 1e308, float("inf"), float("nan")),
    *("", "x", "\x1b[2J\u202e", "../../etc/passwd", "9" * 5000, [], {}, [0], [[[]]], {"": {}}, [1e308] * 64),
)


def pick(options: Any, rng: np.random.Generator) -> Any:
    """One of them."""
    return options[int(rng.integers(len(options)))]


def of_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Up to four changes: bits, spans that are gone, doubled or random, an odd word, an early end."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(changed) + 1))
        span = int(min(rng.integers(1, 64), len(changed) - at))
        kind = rng.integers(6)
        if kind == 0 and span:
            changed[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del changed[at : at + span]
        elif kind == 2:
            changed[at:at] = changed[at : at + span]
        elif kind == 3:
            changed[at : at + span] = rng.bytes(span)
        elif kind == 4:
            changed[at : at + span] = pick(WORDS, rng).encode("utf-8", "surrogatepass")
        elif rng.random() < 0.3:
            del changed[at:]
    return bytes(changed)


def of_head(data: bytes, rng: np.random.Generator) -> bytes:
    """The same in the first 400 bytes, where most formats say what follows."""
    return of_bytes(data[:400], rng) + data[400:]


def of_words(data: bytes, rng: np.random.Generator) -> bytes:
    """Of a text: a word that is another, gone or doubled; a line that is gone, doubled or elsewhere."""
    lines = data.split(b"\n")
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(lines)))
        words, kind = lines[at].split(b" "), rng.integers(5)
        if kind == 0:
            words[int(rng.integers(len(words)))] = pick(WORDS, rng).encode("utf-8", "surrogatepass")
        elif kind == 1:
            del words[int(rng.integers(len(words)))]
        elif kind == 2:
            words += words[-1:]
        lines[at] = b" ".join(words)
        if kind == 3:
            lines[at:at] = [lines[at]] * int(rng.integers(1, 4))
        elif kind == 4:
            lines.insert(int(rng.integers(len(lines))), lines.pop(at))
    return b"\n".join(lines)


def changed(value: Any, rng: np.random.Generator) -> Any:
    """A value of JSON or of a checkpoint with one change somewhere within."""
    if isinstance(value, dict | list | tuple) and len(value) and rng.random() < 0.92:
        items = dict(value) if isinstance(value, dict) else dict(enumerate(value))
        key, kind = pick(list(items), rng), rng.random()
        if kind < 0.08:
            del items[key]
        elif kind < 0.14:
            items[key if isinstance(key, int) else pick(("x", "", "height", "name"), rng)] = pick(VALUES, rng)
        else:
            items[key] = changed(items[key], rng)
        return items if isinstance(value, dict) else type(value)(items.values())
    return _nested(int(rng.integers(1, 2000))) if rng.random() < 0.05 else pick(VALUES, rng)


def _nested(levels: int) -> list[Any]:
    found: list[Any] = []
    for _ in range(levels):
        found = [found]
    return found


def of_json(data: bytes, rng: np.random.Generator) -> bytes:
    """Up to three values that are others, gone or new."""
    value = json.loads(data)
    for _ in range(rng.integers(1, 4)):
        value = changed(value, rng)
    try:
        return json.dumps(value).encode()
    except (RecursionError, ValueError):  # nested deeper than is written
        return b'{"x": ' + b"[" * 5000 + b"]" * 5000 + b"}"


def changed_array(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Another shape, type or content."""
    kind = rng.integers(8)
    if kind == 0:
        return np.ones(array.shape, pick(("f8", "f2", "i4", "u1", "c8", "?", "S4"), rng))
    if kind == 1:
        return array.reshape(-1)
    if kind == 2:
        return array[: len(array) // 2] if array.ndim else array[None]
    if kind == 3:
        return array.T
    if kind == 4:
        return np.zeros((0, *array.shape[1:]), array.dtype)
    if kind == 5:
        return array[None]
    found = np.array(array, np.float32)
    found.reshape(-1)[rng.integers(max(1, found.size), size=3) if found.size else []] = pick(
        (np.nan, np.inf, -np.inf, 3e38, 1e-40), rng
    )
    return found if kind == 6 else np.full_like(found, 1e30)


def of_npz(data: bytes, rng: np.random.Generator) -> bytes:
    """Arrays of an .npz that are others, gone, or called otherwise."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = dict(archive)
    for _ in range(rng.integers(1, 3)):
        name, kind = pick(list(arrays), rng), rng.random()
        array = arrays.pop(name)
        if kind > 0.15:
            arrays[pick(("x", f"{name}.x", "a/../b"), rng) if kind < 0.3 else name] = (
                array if kind < 0.3 else changed_array(array, rng)
            )
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def of_onnx(data: bytes, rng: np.random.Generator) -> bytes:
    """A network with other operations, attributes, weights or names."""
    import onnx

    model = onnx.load_from_string(data)
    graph = model.graph
    for _ in range(rng.integers(1, 4)):
        node, tensor, kind = pick(graph.node, rng), pick(graph.initializer, rng), rng.integers(11)
        if kind == 0:
            node.op_type = pick(graph.node, rng).op_type
        elif kind == 1 and node.attribute:
            attribute = pick(node.attribute, rng)
            if attribute.ints:
                attribute.ints[int(rng.integers(len(attribute.ints)))] = pick((-1, 0, 2, 63, 1 << 20, -(1 << 62)), rng)
            else:
                attribute.i, attribute.f = pick((-1, 0, 9, 1 << 40), rng), float("nan")
        elif kind == 2 and node.input:
            node.input[int(rng.integers(len(node.input)))] = pick(
                ("", "image", pick(graph.initializer, rng).name, pick(graph.node, rng).output[0]), rng
            )
        elif kind == 3:
            graph.node.remove(node)
        elif kind == 4:
            graph.node.append(node)
        elif kind == 5 and tensor.dims:
            tensor.dims[int(rng.integers(len(tensor.dims)))] = pick((0, 1, -1, 3, 1 << 40), rng)
        elif kind == 6:
            tensor.data_type = pick((1, 2, 3, 6, 7, 10, 11, 0, 99), rng)
        elif kind == 7:
            tensor.raw_data = of_bytes(tensor.raw_data, rng)
        elif kind == 8:
            tensor.raw_data = rng.bytes(len(tensor.raw_data))
        elif kind == 9:
            dimensions = pick([*graph.input, *graph.output], rng).type.tensor_type.shape.dim
            if dimensions:
                pick(dimensions, rng).dim_value = pick((-1, 0, 1, 7, 1 << 40), rng)
        else:
            pick(graph.output, rng).name = pick(("x", "features", pick(graph.node, rng).output[0]), rng)
    return model.SerializeToString()


def of_checkpoint(data: bytes, rng: np.random.Generator) -> bytes:
    """A checkpoint whose tensors or values are others."""
    import torch

    content = torch.load(io.BytesIO(data), weights_only=True)
    for _ in range(rng.integers(1, 3)):
        content = changed(content, rng)
    if isinstance(content, dict) and rng.random() < 0.5:
        states = [one for one in (content.get("image_net"), content.get("point_head")) if isinstance(one, dict) and one]
        if states:
            state = pick(states, rng)
            name = pick(list(state), rng)
            if isinstance(state[name], torch.Tensor):
                other = changed_array(np.zeros(state[name].shape, "f4"), rng)
                state[name] = torch.from_numpy(other if other.dtype.kind != "S" else other.astype("f4"))
    file = io.BytesIO()
    try:
        torch.save(content, file)
    except RecursionError:  # nested deeper than is written
        torch.save({"x": _nested(100)}, file := io.BytesIO())
    return file.getvalue()


def mixed(*ways: Mutate) -> Mutate:
    """One of these each time."""
    return lambda data, rng: pick(ways, rng)(data, rng)
