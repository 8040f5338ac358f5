"""Scans written into bags, with `rosbags`."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.recordings.old_rosbags import is_old

TF = "tf2_msgs/msg/TFMessage"
CLOUD, ODOMETRY, POSE = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
KINDS = ("bag", "db3", "mcap")
CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
PLAIN = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
START = 1_700_000_000  # s


class BagWriter:
    """A bag of ROS 1 or 2 that is being written: `with BagWriter(path, kind) as bag:`."""

    def __init__(self, path: Path, kind: str) -> None:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.ros1 = kind == "bag"
        self.types = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            self.writer = rosbag1.Writer(path)
        elif is_old():
            if kind == "mcap":
                pytest.skip("this rosbags writes no MCAP")
            self.writer = rosbag2.Writer(path)
        else:
            plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
            self.writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        self.connections = {}
        if self.ros1:
            self.types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *_):
        self.writer.close()

    def write(self, topic: str, kind: str, message, received: float) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.types)
        encode = self.types.serialize_ros1 if self.ros1 else self.types.serialize_cdr
        self.writer.write(self.connections[topic], round(1e9 * (START + received)), encode(message, kind))

    def make(self, kind: str, **content):
        return self.types.types[kind](**content)

    def header(self, time: float, frame: str):
        nanoseconds = round(1e9 * time)
        stamp = self.make("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return self.make("std_msgs/msg/Header", **({"seq": 0} if self.ros1 else {}), stamp=stamp, frame_id=frame)

    def cloud(
        self, scan, time, *, topic="/points", frame="lidar", stamp=None, dtype=PLAIN, shape=None, padding=0, lost=0
    ):
        """A scan (N, 4). dtype: of a point; shape: rows and columns; padding: bytes after each row; lost: at the end"""
        points = np.zeros(len(scan), dtype)
        for index, name in enumerate(("x", "y", "z", "intensity")):
            if name in dtype.names:
                points[name] = scan[:, index]
        if "ring" in dtype.names:
            points["ring"] = np.arange(len(scan)) % 64
        if "t" in dtype.names:
            points["t"] = np.linspace(0, 1e8, len(scan))  # ns
        rows, width = shape or (1, len(scan))
        data = points.reshape(rows, width).view(np.uint8).reshape(rows, width * dtype.itemsize)
        data = np.pad(data, ((0, 0), (0, padding)))
        fields = [
            self.make(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=dtype.fields[name][1],
                datatype=CODES[dtype[name].str[1:]],
                count=1,
            )
            for name in dtype.names
        ]
        message = self.make(
            CLOUD,
            header=self.header(START + time if stamp is None else stamp, frame),
            height=rows,
            width=width,
            fields=fields,
            is_bigendian=dtype["x"].str[0] == ">",
            point_step=dtype.itemsize,
            row_step=width * dtype.itemsize + padding,
            data=data.reshape(-1)[: data.size - lost],
            is_dense=False,
        )
        self.write(topic, CLOUD, message, time)

    def pose(self, pose, time, *, topic="/odom", child: str | None = "lidar"):
        """Odometry of the frame `child`, or PoseStamped where that is None."""
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        place = self.make("geometry_msgs/msg/Point", x=pose[0, 3], y=pose[1, 3], z=pose[2, 3])
        turn = self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        content = self.make("geometry_msgs/msg/Pose", position=place, orientation=turn)
        header = self.header(START + time, "odom")
        if child is None:
            self.write(topic, POSE, self.make(POSE, header=header, pose=content), time)
            return
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        still = self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        here = self.make("geometry_msgs/msg/PoseWithCovariance", pose=content, covariance=np.zeros(36))
        odometry = self.make(ODOMETRY, header=header, child_frame_id=child, pose=here, twist=still)
        self.write(topic, ODOMETRY, odometry, time)

    def transform(self, pose, time, parent, child, *, topic="/tf"):
        """T_parent_child."""
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        place = self.make("geometry_msgs/msg/Vector3", x=pose[0, 3], y=pose[1, 3], z=pose[2, 3])
        turn = self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        transform = self.make("geometry_msgs/msg/Transform", translation=place, rotation=turn)
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(START + time, parent),
            child_frame_id=child,
            transform=transform,
        )
        self.write(topic, TF, self.make(TF, transforms=[stamped]), time)


def single_file(path: Path) -> Path:
    """The file in a folder that is a bag of ROS 2; a bag of ROS 1 itself."""
    return path if path.is_file() else next(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))


def messages(path: Path) -> dict[tuple[str, str, str], list[tuple[int, bytes]]]:
    """All messages by topic: time and content."""
    from rosbags.highlevel import AnyReader

    found = {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            found.setdefault((connection.topic, connection.msgtype, connection.digest), []).append((time, bytes(data)))
    return found
