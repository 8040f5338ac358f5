from mos_model.data import kitti


def test_published_splits():
    splits = kitti.TRAIN, kitti.VALIDATION, kitti.TEST, kitti.ROAD_TRAIN, kitti.ROAD_VALIDATION
    names = [name for split in splits for name in split]
    assert sorted(names) == [f"{i:02d}" for i in range(22)] + [str(i) for i in range(30, 42)]
