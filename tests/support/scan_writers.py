"""Scans (N, 4) float32 written in other formats than the product's own, as other tools write them."""

from pathlib import Path

import numpy as np

NAMES = ("x", "y", "z", "intensity")
PLY_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def write_pcd(path: Path, scan: np.ndarray, encoding: str) -> None:
    """encoding: ascii, with 9 digits, which is enough for float32; binary; binary_compressed."""
    lines = ["# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {' '.join(NAMES)}", "SIZE 4 4 4 4"]
    lines += ["TYPE F F F F", "COUNT 1 1 1 1", f"WIDTH {len(scan)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0"]
    lines += [f"POINTS {len(scan)}", f"DATA {encoding}", ""]
    if encoding == "ascii":
        body = _text(scan)
    elif encoding == "binary":
        body = scan.astype("<f4").tobytes()
    else:
        import lzf

        full = scan.astype("<f4").T.tobytes()
        packed = lzf.compress(full, 2 * len(full)) if full else b""
        body = np.array([len(packed), len(full)], "<u4").tobytes() + packed
    path.write_bytes("\n".join(lines).encode() + body)


def write_ply(path: Path, scan: np.ndarray, encoding: str) -> None:
    """encoding: of PLY_FORMATS."""
    lines = ["ply", f"format {encoding} 1.0", "comment by hand", f"element vertex {len(scan)}"]
    lines += [*(f"property float {name}" for name in NAMES), "end_header", ""]
    body = _text(scan) if encoding == "ascii" else scan.astype(PLY_FORMATS[encoding] + "f4").tobytes()
    path.write_bytes("\n".join(lines).encode() + body)


def write_las(path: Path, scan: np.ndarray) -> None:
    """Places in tenths of a millimetre, remission in 16 bits; LAZ by the name."""
    import laspy

    las = laspy.create(point_format=0, file_version="1.2")
    las.header.scales, las.header.offsets = [1e-4] * 3, [0.0] * 3
    las.x, las.y, las.z = scan[:, :3].astype(np.float64).T
    las.intensity = np.round(scan[:, 3] * 65535).astype(np.uint16)
    las.write(path)


def _text(scan: np.ndarray) -> bytes:
    return "".join(" ".join(f"{value:.9g}" for value in point) + "\n" for point in scan).encode()
