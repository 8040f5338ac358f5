"""Naive kNN vote, by the rules: every cell of the window in a list, sorted, the first five vote."""

import numpy as np


def knn_vote(labels, range_image, u, v, ranges):
    height, width = labels.shape
    offsets = [(dy, dx) for dy in range(-2, 3) for dx in range(-2, 3)]
    gauss = np.array([np.exp(-(dy * dy + dx * dx) / 2.0) for dy, dx in offsets])
    weights = (1 - gauss / gauss.sum()).astype(np.float32)
    out = np.ones(len(u), np.uint8)
    for i in range(len(u)):
        if u[i] < 0:
            continue
        cells = []
        for (dy, dx), weight in zip(offsets, weights, strict=True):
            y, x = v[i] + dy, u[i] + dx
            inside = 0 <= y < height and 0 <= x < width
            label = labels[y, x] if inside else 0
            cell = range_image[y, x] if inside else np.float32(0)
            if inside and cell == 0:
                cell = np.float32(np.inf)
            if (dy, dx) == (0, 0):
                cell = ranges[i]
            cells.append((abs(cell - ranges[i]) * weight, label))
        cells.sort(key=lambda cell: cell[0])  # stable: row order on equal distance
        votes = [label for distance, label in cells[:5] if distance <= 1.0]
        out[i] = 2 if votes.count(2) > votes.count(1) else 1
    return out
