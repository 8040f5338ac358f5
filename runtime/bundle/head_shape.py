"""The shape of a point head (paper, Sec. III-D): which channels at which stride."""

from dataclasses import dataclass

from runtime.errors import SettingError

DEEPEST, WIDEST = 8, 4096  # stages, channels
VOXELS = 0.001, 10.0  # m


@dataclass(frozen=True)
class PointHeadConfig:
    """Sparse-convolution U-net over voxels with a point branch. Default: the published full head ("v2")."""

    in_channels: int = 32  # width of the image features; the stem keeps it
    down: tuple[int, ...] = (32, 64, 128, 256)  # channels of the encoder stages, each halves the resolution
    up: tuple[int, ...] = (256, 128, 96, 96)  # channels of the decoder stages
    fuse_after_up: int | None = 2  # point branch joins after this many decoder stages too (None: it does not)
    dropout: float = 0.3  # after each joining of the point branch, in training
    voxel_size: float = 0.05  # m
    # feature of a voxel: that of its "first" point in scan order, voxels being counted from the lowest of the scan, as
    # published; or the "mean" of all its points, on a grid that stands still: then no point far away has a say
    reduce: str = "first"

    def __post_init__(self) -> None:
        if len(self.down) != len(self.up) or not self.down:
            raise SettingError(f"a point head needs as many up as down stages, not {self.down} and {self.up}")
        if self.fuse_after_up is not None and not 1 <= self.fuse_after_up < len(self.up):
            raise SettingError(f"fuse_after_up must lie within 1..{len(self.up) - 1}, not {self.fuse_after_up}")
        if len(self.down) > DEEPEST:
            raise SettingError(f"a point head has up to {DEEPEST} down stages, not {len(self.down)}")
        if not all(1 <= channels <= WIDEST for channels in (self.in_channels, *self.down, *self.up)):
            raise SettingError(f"the channels of a point head must be 1 to {WIDEST}")
        if not VOXELS[0] <= self.voxel_size <= VOXELS[1]:
            raise SettingError(f"the voxel size of a point head must be {VOXELS[0]} to {VOXELS[1]} m")
        if not 0 <= self.dropout < 1:
            raise SettingError("the dropout of a point head must be a share below 1")
        if self.reduce not in ("first", "mean"):
            raise SettingError(f"reduce must be 'first' or 'mean', not {self.reduce!r}")


FULL = PointHeadConfig()
LITE = PointHeadConfig(down=(64, 128), up=(96, 96), fuse_after_up=None, dropout=0.0)
SMALL = PointHeadConfig(
    in_channels=16, down=(16, 32), up=(32, 16), fuse_after_up=None, dropout=0.0, voxel_size=0.1, reduce="mean"
)  # for real time


def receptive_field(config: PointHeadConfig) -> int:
    """Greatest distance per axis, in voxels, between a voxel and those that its result depends on."""
    return max(_reach(config, place) for place in range(1 << len(config.down)))


def _reach(config: PointHeadConfig, place: int) -> int:
    """The same for a voxel at `place` in the coarsest grid, on one axis: from the output backwards."""
    depth = len(config.down)
    voxels = points = (place, place)  # first and last position needed of each branch

    def aligned(box: tuple[int, int], stride: int, beyond: int = 0) -> tuple[int, int]:
        return (box[0] // stride - beyond) * stride, (box[1] // stride + beyond) * stride + stride - 1

    def union(a: tuple[int, int], b: tuple[int, int]) -> tuple[int, int]:
        return min(a[0], b[0]), max(a[1], b[1])

    def exchanged(stride: int) -> tuple[tuple[int, int], tuple[int, int]]:
        both = union(voxels, points)
        return (both[0] // stride * stride, (both[1] // stride + 2) * stride - 1), both

    skips = {}
    for stage in range(depth, 0, -1):  # decoder
        stride = 1 << (depth - stage)
        if stage == config.fuse_after_up:
            voxels, points = exchanged(stride)
        voxels = skips[depth - stage] = aligned(voxels, stride, 4)
        voxels = aligned(voxels, 2 * stride)
    voxels, points = exchanged(1 << depth)
    for level in range(depth, 0, -1):  # encoder
        voxels = aligned(aligned(voxels, 1 << level, 4), 1 << level)
        voxels = union(voxels, skips[level - 1])
    low, high = aligned(union(voxels, points), 1, 1)
    return max(place - low, high - place)
