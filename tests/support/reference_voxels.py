"""The point head as simply as it can be written: dictionaries, float64, a loop per idea. Slow on purpose."""

import importlib.util

import numpy as np

from export.bundle.head_weights import has_norm, is_linear
from export.checkpoint.key_map import head_modules, under_our_names
from runtime.bundle.head_shape import FULL, LITE
from runtime.head.weights import layers
from tests.support.paths import PUBLISHED

CUBE3 = [(x, y, z) for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1)]  # x fastest
CUBE2 = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]  # z fastest


def published_weights(name, seed=2026):
    """Reference weights of a published head ("full" or "lite"), under our names."""
    spec = importlib.util.spec_from_file_location("reference_weights", PUBLISHED / "reference_weights.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    state = module.reference_state_dict(f"point_head_{name}", seed)
    return under_our_names(state, head_modules({"full": FULL, "lite": LITE}[name]))


def voxelise(xyz, size, valid, step=1):
    """(coordinates in any order, voxel of each point or -1, first point of each voxel)."""
    cells = np.round(xyz / np.float32(size))
    cells = cells - np.floor(cells[valid].min(axis=0) / step) * step if valid.any() else cells
    voxels, inverse, first = [], np.full(len(xyz), -1), []
    rows = {}
    for i in np.flatnonzero(valid):
        cell = tuple(int(c) for c in cells[i])
        if cell not in rows:
            rows[cell] = len(voxels)
            voxels.append(cell)
            first.append(i)
        inverse[i] = rows[cell]
    return voxels, inverse, first


def parent(voxel, stride):
    """Lower corner of the voxel of this stride that holds `voxel`."""
    return tuple(c // stride * stride for c in voxel)


def shifted(voxel, offset, stride):
    return tuple(c + stride * d for c, d in zip(voxel, offset, strict=True))


def conv3(features, kernel, stride):
    """{voxel: row} -> {voxel: row}: out[o] = sum_k in[o + offset_k] @ W[k]."""
    out = {}
    for voxel in features:
        out[voxel] = np.zeros(kernel.shape[2])
        for k, offset in enumerate(CUBE3):
            other = shifted(voxel, offset, stride)
            if other in features:
                out[voxel] = out[voxel] + features[other] @ kernel[k]
    return out


def down(features, kernel, stride):
    """To twice the stride."""
    out = {}
    for voxel in features:
        coarse = parent(voxel, 2 * stride)
        offset = tuple((c - d) // stride for c, d in zip(voxel, coarse, strict=True))
        out[coarse] = out.get(coarse, 0) + features[voxel] @ kernel[CUBE2.index(offset)]
    return out


def up(features, kernel, stride, finer):
    """From twice the stride onto the voxels `finer`."""
    out = {}
    for voxel in finer:
        coarse = parent(voxel, 2 * stride)
        offset = tuple((c - d) // stride for c, d in zip(voxel, coarse, strict=True))
        out[voxel] = features[coarse] @ kernel[CUBE2.index(offset)]
    return out


def voxels_to_points(features, points, stride):
    out = {}
    for point in points:
        base = parent(point, stride)
        place = [(c - d) / stride for c, d in zip(point, base, strict=True)]
        total, weights = 0, 0
        for offset in CUBE2:
            corner = shifted(base, offset, stride)
            if corner in features:
                weight = np.prod([f if d else 1 - f for f, d in zip(place, offset, strict=True)])
                total, weights = total + weight * features[corner], weights + weight
        out[point] = total / weights
    return out


def points_to_voxels(features, stride):
    groups = {}
    for point, row in features.items():
        groups.setdefault(parent(point, stride), []).append(row)
    return {voxel: np.mean(rows, axis=0) for voxel, rows in groups.items()}


class Head:
    """The whole head in evaluation mode, from the state dict of a `PointHead`."""

    def __init__(self, weights, config):
        self.weights = {key: np.asarray(value, np.float64) for key, value in weights.items()}
        self.config = config

    def norm(self, features, at):
        w = self.weights
        scale = w[f"{at}.weight"] / np.sqrt(w[f"{at}.running_var"] + 1e-5)
        return {v: (x - w[f"{at}.running_mean"]) * scale + w[f"{at}.bias"] for v, x in features.items()}

    def residual(self, features, at, stride):
        kernel = self.weights
        x = self.norm(conv3(features, kernel[f"{at}.conv1.kernel"], stride), f"{at}.conv1.norm")
        x = self.norm(conv3(relu(x), kernel[f"{at}.conv2.kernel"], stride), f"{at}.conv2.norm")
        shortcut = features
        if f"{at}.shortcut.kernel" in kernel:
            shortcut = {v: row @ kernel[f"{at}.shortcut.kernel"] for v, row in features.items()}
            shortcut = self.norm(shortcut, f"{at}.shortcut.norm")
        return relu({v: x[v] + shortcut[v] for v in x})

    def points(self, features, i):
        at = f"point_transforms.{i}"
        weight, bias = self.weights[f"{at}.weight"], self.weights[f"{at}.bias"]
        return relu(self.norm({v: row @ weight.T + bias for v, row in features.items()}, f"{at}.norm"))

    def exchange(self, x, z, i, stride):
        new = self.points(z, i)
        old = voxels_to_points(x, list(z), stride)
        z = {v: old[v] + new[v] for v in z}
        return points_to_voxels(z, stride), z

    def __call__(self, features):
        """{voxel: feature row} of stride 1 -> {voxel: probabilities}."""
        w, config, depth = self.weights, self.config, len(self.config.down)
        x = z = relu(self.norm(conv3(features, w["stem.kernel"], 1), "stem.norm"))
        skips = [x]
        for i in range(1, depth + 1):
            x = relu(self.norm(down(x, w[f"stage{i}.0.kernel"], 2 ** (i - 1)), f"stage{i}.0.norm"))
            x = self.residual(self.residual(x, f"stage{i}.1", 2**i), f"stage{i}.2", 2**i)
            skips.append(x)
        x, z = self.exchange(x, z, 0, 2**depth)
        for i in range(1, depth + 1):
            stride, skip = 2 ** (depth - i), skips[depth - i]
            x = relu(self.norm(up(x, w[f"up{i}.0.kernel"], stride, skip), f"up{i}.0.norm"))
            x = {v: np.concatenate((x[v], skip[v])) for v in x}
            x = self.residual(self.residual(x, f"up{i}.1.0", stride), f"up{i}.1.1", stride)
            if i == config.fuse_after_up:
                x, z = self.exchange(x, z, 1, stride)
        last = self.points(z, 1 if config.fuse_after_up is None else 2)
        return {v: self.softmax(x[v] + last[v]) for v in x}

    def softmax(self, row):
        logits = row @ self.weights["classifier.weight"].T + self.weights["classifier.bias"]
        exponents = np.exp(logits - logits.max())
        return exponents / exponents.sum()


def relu(features):
    return {v: np.maximum(row, 0) for v, row in features.items()}


def refine(weights, config, xyz, valid, features):
    """Probabilities (N, 3) of all valid points, NaN for the others."""
    step = 2 ** len(config.down) if config.reduce == "mean" else 1
    voxels, inverse, first = voxelise(xyz, config.voxel_size, valid, step)
    if config.reduce == "mean":
        rows = {v: features[inverse == i].mean(axis=0, dtype=np.float64) for i, v in enumerate(voxels)}
    else:
        rows = {v: features[first[i]].astype(np.float64) for i, v in enumerate(voxels)}
    found = Head(weights, config)(rows) if voxels else {}
    out = np.full((len(xyz), 3), np.nan)
    for i in np.flatnonzero(valid):
        out[i] = found[voxels[inverse[i]]]
    return out


def random_weights(config, seed=0):
    """A state dict for any configuration, with gains that keep the features' size."""
    rng = np.random.default_rng(seed)
    weights = {}
    for layer in layers(config):
        linear, norm = is_linear(layer), f"{layer.name}.norm"
        shape = layer.shape[::-1] if linear else layer.shape
        spread = 1 / np.sqrt(sum(layer.inputs) * max(1, layer.offsets / 4))
        weights[f"{layer.name}.{'weight' if linear else 'kernel'}"] = rng.normal(0, spread, shape).astype(np.float32)
        if linear:
            weights[f"{layer.name}.bias"] = rng.normal(0, 0.1, layer.outputs).astype(np.float32)
        if has_norm(layer):
            for name, values in {
                "weight": rng.uniform(0.8, 1.2, layer.outputs),
                "bias": rng.normal(0, 0.1, layer.outputs),
                "running_mean": rng.normal(0, 0.1, layer.outputs),
                "running_var": rng.uniform(0.8, 1.2, layer.outputs),
            }.items():
                weights[f"{norm}.{name}"] = values.astype(np.float32)
            weights[f"{norm}.num_batches_tracked"] = np.int64(7)
    return weights


def surfaces(seed, count, extent=6.0):
    """Points in whole millimetres on a ground and a few walls, with ties of the rounding and duplicates."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(-extent / 2, extent / 2, (count, 3))
    xyz[:, 2] = rng.normal(-1.5, 0.02, count)
    walls = rng.random(count) < 0.5
    xyz[walls, 2] = rng.uniform(-1.5, 0.5, walls.sum())
    xyz[walls, 0] = np.round(xyz[walls, 0]) + 0.1 * xyz[walls, 1]
    xyz = np.round(xyz, 3).astype(np.float32)
    xyz[-count // 10 :] = xyz[: len(xyz[-count // 10 :])]
    return xyz
