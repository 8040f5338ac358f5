"""Belief as simply as it can be written: dictionaries, float64, a loop per idea. Slow on purpose."""

import math

import numpy as np

MOST = 9.21  # log-odds that a probability counts for at most


def places(points, takes_part, pose, probability, size):
    """(voxel of each point or None, mean log-odds of each voxel), voxels as triples of the world's grid."""
    cells, found = [], {}
    for point, counts, p in zip(points, takes_part, probability, strict=True):
        cells.append(None)
        if counts:
            world = pose[:3, :3] @ point[:3].astype(np.float64) + pose[:3, 3]
            cells[-1] = tuple(math.floor(c) for c in world / size)
            found.setdefault(cells[-1], []).append(log_odds(float(p)))
    return cells, {cell: sum(values) / len(values) for cell, values in found.items()}


def log_odds(p):
    """Of a probability, limited."""
    if p <= 0 or p >= 1:
        return math.copysign(MOST, p - 0.5)
    return min(max(math.log(p / (1 - p)), -MOST), MOST)


def recalled(past, horizon):
    """The sum of what the last scans found at each voxel; `past`: for each scan {voxel: evidence}, oldest first."""
    total = {}
    for scan in past[-horizon:]:
        for voxel, evidence in scan.items():
            total[voxel] = total.get(voxel, 0.0) + evidence
    return total


def objects(cells, log_odds, least):
    """Sets of the points (numbers) from `least` on whose voxels touch, if only at a corner; `cells`: voxel or None."""
    inside = {}
    for i, (cell, value) in enumerate(zip(cells, log_odds, strict=True)):
        if cell is not None and value >= least:
            inside.setdefault(cell, set()).add(i)
    while inside:
        cell, found = inside.popitem()
        edge = [cell]
        while edge:
            here = edge.pop()
            for near in [cell for cell in inside if touch(cell, here)]:
                found |= inside.pop(near)
                edge.append(near)
        yield sorted(found)


def agreed(cells, log_odds, least, doubtful, trail=(), more=0.0):
    """The log-odds of all points, where those of an object have its median, but that those below `doubtful` are not
    raised; of an even number the upper one. Those of objects in the trail have `more`."""
    values = list(log_odds)
    for found in objects(cells, log_odds, least):
        median = middle(log_odds[j] for j in found)
        for i in found:
            if log_odds[i] >= min(doubtful, median):
                values[i] = median + more * (cells[i] in trail)
    return values


def trail(cells, log_odds, least, before, sure, longest):
    """{voxel: scans since its object surely moved}; `before`: that of the scan before."""
    kept = {}
    for found in objects(cells, log_odds, least):
        voxels = {cells[i] for i in found}
        ages = [age + 1 for other, age in before.items() if any(touch(other, voxel) for voxel in voxels)]
        ages += [0] if middle(log_odds[i] for i in found) > sure else []
        if ages and min(ages) <= longest:
            kept.update(dict.fromkeys(voxels, min(ages)))
    return kept


def middle(values):
    """The median, of an even number the upper one."""
    values = sorted(values)
    return values[len(values) // 2]


def touch(one, other):
    """Whether two voxels do, if only at a corner; or are one."""
    return max(abs(a - b) for a, b in zip(one, other, strict=True)) <= 1


class Sets:
    """Sets of voxels of which the one that was seen longest ago gives way: no hash, no slots, whole histories."""

    def __init__(self, horizon, ways, set_of):
        self.horizon, self.ways, self.set_of = horizon, ways, set_of
        self.now, self.rows = 0, {}

    def add(self, keys, evidence):
        """The voxels of one scan, in their order."""
        for key, value in zip(keys, evidence, strict=True):
            row = self.rows.setdefault(self.set_of(key), {})  # key: {scan: evidence}
            if key not in row and len(row) == self.ways:
                eldest = min(row, key=lambda other: (max(row[other]), other))
                if max(row[eldest]) == self.now:
                    continue
                del row[eldest]
            row.setdefault(key, {})[self.now] = value
        self.now += 1

    def recall(self, key):
        """The sum over the last scans."""
        seen = self.rows.get(self.set_of(key), {}).get(key, {})
        return sum(value for scan, value in seen.items() if scan >= self.now - self.horizon)
