"""The published splits of SemanticKITTI-MOS and KITTI-Road-MOS, by the names of their sequences."""

TRAIN = ("00", "01", "02", "03", "04", "05", "06", "07", "09", "10")
VALIDATION = ("08",)
TEST = tuple(f"{number}" for number in range(11, 22))
ROAD_TRAIN = ("30", "31", "32", "33", "34", "40")
ROAD_VALIDATION = ("35", "36", "37", "38", "39", "41")
