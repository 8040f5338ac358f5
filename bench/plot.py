"""Plots as SVG, without a plotting library."""

from collections.abc import Mapping, Sequence
from math import ceil, floor, log10
from pathlib import Path

from runtime.files import write_whole

WIDTH, HEIGHT, MARGIN = 640, 420, 60  # pixels


def loglog(path: Path, points: Sequence[tuple[float, float]], title: str, x_name: str, y_name: str) -> None:
    """Write `points` (x, y), all positive, with a grid line a decade and the value beside each point."""
    xs, ys = zip(*points, strict=True)
    left, right, low, high = floor(log10(min(xs))), ceil(log10(max(xs))), floor(log10(min(ys))), ceil(log10(max(ys)))

    def place(x: float, y: float) -> tuple[float, float]:
        across = (log10(x) - left) / max(1, right - left)
        up = (log10(y) - low) / max(1, high - low)
        return MARGIN + across * (WIDTH - 2 * MARGIN), HEIGHT - MARGIN - up * (HEIGHT - 2 * MARGIN)

    def line(a: tuple[float, float], b: tuple[float, float]) -> str:
        return f'<path d="M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" stroke="#ccc"/>'

    def text(at: tuple[float, float], words: str, anchor: str = "middle") -> str:
        return f'<text x="{at[0]:.1f}" y="{at[1]:.1f}" text-anchor="{anchor}">{words}</text>'

    parts = []
    for power in range(left, right + 1):
        foot, top = place(10.0**power, 10.0**low), place(10.0**power, 10.0**high)
        parts += [line(foot, top), text((foot[0], foot[1] + 18), f"{10**power:g}")]
    for power in range(low, high + 1):
        start, end = place(10.0**left, 10.0**power), place(10.0**right, 10.0**power)
        parts += [line(start, end), text((start[0] - 8, start[1] + 4), f"{10.0**power:g}", "end")]
    places = [place(x, y) for x, y in points]
    track = "L".join(f"{x:.1f} {y:.1f}" for x, y in places)
    parts.append(f'<path d="M{track}" stroke="#1f77b4" stroke-width="2" fill="none"/>')
    for (x, y), (_, value) in zip(places, points, strict=True):
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#1f77b4"/>', text((x, y - 10), f"{value:.3g}")]
    parts += [text((WIDTH / 2, 24), title), text((WIDTH / 2, HEIGHT - 14), x_name), text((8, 40), y_name, "start")]
    _write(path, HEIGHT, parts)


COLOURS = ("#7f7f7f", "#2ca02c", "#1f77b4", "#d62728", "#9467bd", "#8c564b")


def stacked_bars(path: Path, rows: Mapping[str, Mapping[str, float]], title: str) -> None:
    """Write one bar a row: its parts (name -> length) one after the other, their sum at the end."""
    names = list(dict.fromkeys(part for row in rows.values() for part in row))
    colours = dict(zip(names, COLOURS, strict=True))
    scale = (WIDTH - 3 * MARGIN - 80) / max(sum(row.values()) for row in rows.values())
    height = 90 + 34 * len(rows)
    parts = [f'<text x="{WIDTH / 2}" y="20" text-anchor="middle">{title}</text>']
    for i, name in enumerate(names):
        x = 20 + i * 100
        parts.append(f'<rect x="{x}" y="36" width="12" height="12" fill="{colours[name]}"/>')
        parts.append(f'<text x="{x + 17}" y="46">{name}</text>')
    for i, (name, row) in enumerate(rows.items()):
        x, y = 2.0 * MARGIN + 20, 66 + 34 * i
        parts.append(f'<text x="{x - 8}" y="{y + 16}" text-anchor="end">{name}</text>')
        for part, length in row.items():
            parts.append(f'<rect x="{x:.1f}" y="{y}" width="{length * scale:.1f}" height="22" fill="{colours[part]}"/>')
            x += length * scale
        parts.append(f'<text x="{x + 6:.1f}" y="{y + 16}">{sum(row.values()):.0f}</text>')
    _write(path, height, parts)


def _write(path: Path, height: int, parts: Sequence[str]) -> None:
    body = "\n".join(parts)
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" '
        f'font-size="12">\n<rect width="{WIDTH}" height="{height}" fill="white"/>\n{body}\n</svg>\n'
    )
    write_whole(path, svg.encode())
