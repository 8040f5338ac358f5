"""What the paper says of each method, and what a few seeds of ours say beside it: means, spreads, claims.

Spread: the standard deviation over the seeds of one method, pooled over all methods of a column. Two methods are told
apart where their means differ by more than the least significant difference, t * spread * sqrt(2 / seeds), with t of
95 % (Fisher); two post-processings of the same networks by what they gain seed by seed, without the 2. How many seeds
would tell the paper's own difference apart follows from the same.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

Scores = Mapping[str, float]  # moving IoU, %, by post-processing
Seeds = Sequence[Scores]  # of one method


class Method(NamedTuple):
    """A row of the paper's tables."""

    config: str
    what: str
    paper: Scores  # on sequence 08
    kinds: tuple[str, ...] = ("none", "knn", "head")  # post-processings


METHODS = {
    "a": Method("lmnet", "LMNet: one branch", {"none": 58.11, "knn": 62.51, "head": 64.05}),
    "b": Method("b", "two branches, attention", {"none": 60.85, "knn": 65.50, "head": 67.74}),
    "c": Method("c", "b + SoftPool", {"none": 61.65, "knn": 66.27, "head": 68.52}),
    "d": Method("d", "b + MetaKernel", {"none": 62.75, "knn": 67.57, "head": 70.26}),
    "e": Method("e", "b + both: v1, with the head v2", {"none": 63.17, "knn": 68.07, "head": 71.42}),
    "rt": Method("rt", "rt: two branches for a CPU", {}),
    "limoseg": Method("limoseg", "LiMoSeg: two scans from above", {"none": 52.60}, ("none",)),
    "cylinder3d": Method("cylinder3d", "Cylinder3D: two scans in a cylinder", {"none": 66.29}, ("none",)),
}
CLAIMS = (  # the first is the better one in the paper
    (("a", "none"), ("limoseg", "none")),
    (("e", "none"), ("a", "none")),
    (("b", "none"), ("a", "none")),
    (("c", "none"), ("b", "none")),
    (("d", "none"), ("b", "none")),
    (("e", "none"), ("c", "none")),
    (("e", "none"), ("d", "none")),
    (("cylinder3d", "none"), ("e", "none")),
    (("a", "knn"), ("a", "none")),
    (("e", "knn"), ("e", "none")),
    (("e", "knn"), ("a", "knn")),
    (("a", "head"), ("a", "knn")),
    (("e", "head"), ("e", "knn")),
    (("e", "head"), ("a", "head")),
    (("e", "head"), ("cylinder3d", "none")),
)
RUNTIMES = {  # rows of `bench.latency` and `bench.comparators`, and milliseconds of the paper on an RTX 3090
    "LMNet, kNN": 13.31,
    "Cylinder3D": 124.38,
    "v1, kNN": 41.81,
    "v2, all points": 116.93,
    "v2-lite, all points": 85.25,
    "LiMoSeg": None,
    "default bundle": None,
}


class Spread(NamedTuple):
    """Of the seeds around their method's mean, in points of IoU."""

    deviation: float
    freedom: int  # degrees of freedom

    def least(self, share: float) -> float | None:
        """The difference beyond chance whose variance is this share of a seed's; None: nothing can be said."""
        from scipy.stats import t

        return float(t.ppf(0.975, self.freedom) * self.deviation * share**0.5) if self.freedom else None


def spread(found: Mapping[str, Seeds], kind: str, less: str | None = None) -> Spread:
    """Of a post-processing, or of what it gains over another of the same networks; pooled over methods that have it."""
    values = [
        [one[kind] - (one[less] if less else 0.0) for one in seeds]
        for name, seeds in found.items()
        if seeds and kind in METHODS[name].kinds
    ]
    freedom = sum(len(each) - 1 for each in values)
    squares = sum(len(each) * float(np.var(each)) for each in values)
    return Spread((squares / freedom) ** 0.5 if freedom else float("nan"), freedom)


def summary(found: Mapping[str, Seeds]) -> dict[str, dict[str, Any]]:
    """Of each method and post-processing: mean, standard deviation and number of seeds, beside the paper's."""
    rows: dict[str, dict[str, Any]] = {}
    for name, seeds in found.items():
        rows[name] = {}
        for kind in METHODS[name].kinds if seeds else ():
            values = [one[kind] for one in seeds]
            deviation = round(float(np.std(values, ddof=1)), 1) if len(values) > 1 else None
            rows[name][kind] = {
                "mean": round(float(np.mean(values)), 1),
                "deviation": deviation,
                "seeds": len(values),
                "paper": METHODS[name].paper.get(kind),
            }
    return rows


def claims(found: Mapping[str, Seeds]) -> Iterator[dict[str, Any]]:
    """How much better one method is than another, here and in the paper, and what would tell them apart."""
    for (better, kind), (worse, other) in CLAIMS:
        seeds = min(len(found.get(better, ())), len(found.get(worse, ())))
        if not seeds:
            continue
        ours = _mean(found[better], kind) - _mean(found[worse], other)
        paper = METHODS[better].paper[kind] - METHODS[worse].paper[other]
        if better == worse:  # the same networks: what a seed gains
            least = spread(found, kind, other).least(1 / seeds)
        else:
            least = max(spread(found, one) for one in (kind, other)).least(2 / seeds)
        yield {
            "better": f"{better}, {kind}",
            "worse": f"{worse}, {other}",
            "points": round(ours, 1),
            "paper": round(paper, 1),
            "least_significant": None if least is None else round(least, 1),
            "separated": least is not None and abs(ours) > least,
            "seeds_for_the_papers": None if least is None else max(2, int(np.ceil(seeds * (least / paper) ** 2))),
        }


def _mean(seeds: Seeds, kind: str) -> float:
    return float(np.mean([one[kind] for one in seeds]))


def shown(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, str]]:
    """A summary for people: "31.2 ± 1.4", and the paper's number."""
    table: dict[str, dict[str, str]] = {}
    for name, row in rows.items():
        if not row:
            continue
        cells = table.setdefault(f"{name}: {METHODS[name].what}", {})
        for kind, one in row.items():
            around = "" if one["deviation"] is None else f" ± {one['deviation']:.1f}"
            cells[kind] = f"{one['mean']:.1f}{around}"
            cells[f"{kind}, paper"] = "" if one["paper"] is None else f"{one['paper']:.2f}"
    return table


def runtimes(latency: Mapping[str, Any], comparators: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Milliseconds a scan by `bench.latency`, or else `bench.comparators`, and of which CPU; beside the paper's."""
    rows = {}
    for name, paper in RUNTIMES.items():
        for machine, measured in ((latency["machine"], latency["rows"]), (comparators["machine"], comparators)):
            if name in measured and name not in rows:
                ms = measured[name]["ms"]["scan"]["median"]
                rows[name] = {"ms": ms, "cpu": machine["cpu"], "paper": paper}
    return rows
