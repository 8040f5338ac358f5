"""A ROS 2 system as DDS shows it: types written down from ROS's message files, and a process that replays a drive.

`python -m tests.support.ros_system DRIVE.npz ANSWERS.npz DOMAIN POSES`: publishes the scans of a drive ten times a
second, and keeps what is answered. POSES: tf, odometry, or none.
"""

import os
import sys
import time
from dataclasses import dataclass

import numpy as np
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from scipy.spatial.transform import Rotation

PERIOD = 0.1  # s
LONGEST = 120.0  # s, for somebody to come, and for an answer
ALONE = (  # on this machine alone, whatever its network lets through
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>"
)


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class PointField(IdlStruct, typename="sensor_msgs.msg.dds_.PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs.msg.dds_.PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs.msg.dds_.TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs.msg.dds_.Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


FIELDS = [PointField(name, 4 * index, 7, 1) for index, name in enumerate(("x", "y", "z", "intensity"))]
SENSOR, RELIABLE = Policy.Reliability.BestEffort, Policy.Reliability.Reliable(duration(milliseconds=100))
LATCHED = Policy.Durability.TransientLocal


def header(time_s: float, frame: str) -> Header:
    nanoseconds = round(1e9 * time_s)
    return Header(Time(nanoseconds // 10**9, nanoseconds % 10**9), frame)


def cloud(scan: np.ndarray, time_s: float, frame: str = "lidar") -> PointCloud2:
    """Of a scan (N, 4)."""
    data = list(np.ascontiguousarray(scan, "<f4").tobytes())
    return PointCloud2(header(time_s, frame), 1, len(scan), FIELDS, False, 16, 16 * len(scan), data, True)


def transforms(pose: np.ndarray, time_s: float, parent: str, child: str) -> TFMessage:
    turn = Quaternion(*Rotation.from_matrix(pose[:3, :3]).as_quat())
    transform = Transform(Vector3(*pose[:3, 3]), turn)
    return TFMessage([TransformStamped(header(time_s, parent), child, transform)])


def odometry(pose: np.ndarray, time_s: float, parent: str, child: str) -> Odometry:
    turn = Quaternion(*Rotation.from_matrix(pose[:3, :3]).as_quat())
    zero = Vector3(0.0, 0.0, 0.0)
    here = PoseWithCovariance(Pose(Point(*pose[:3, 3]), turn), [0.0] * 36)
    still = TwistWithCovariance(Twist(zero, zero), [0.0] * 36)
    return Odometry(header(time_s, parent), child, here, still)


def columns(message: PointCloud2) -> dict[str, np.ndarray]:
    """The fields of a cloud (N,)."""
    kinds = {2: "u1", 7: "<f4"}
    record = np.dtype(
        {
            "names": [one.name for one in message.fields],
            "formats": [kinds[one.datatype] for one in message.fields],
            "offsets": [one.offset for one in message.fields],
            "itemsize": message.point_step,
        }
    )
    points = np.frombuffer(bytes(message.data), record, message.width * message.height)
    return {name: points[name] for name in record.names}


class System:
    """The drivers of a robot."""

    def __init__(self, domain: int, reliability: object = SENSOR) -> None:
        self.participant = DomainParticipant(domain)
        self.clouds = self.writer("rt/points", PointCloud2, reliability)
        self.tf = self.writer("rt/tf", TFMessage, RELIABLE)
        self.tf_static = self.writer("rt/tf_static", TFMessage, RELIABLE, LATCHED)
        self.odometry = self.writer("rt/odom", Odometry, RELIABLE)
        self.answers = {
            name: DataReader(
                self.participant,
                Topic(self.participant, f"rt/points/{name}", PointCloud2),
                Qos(RELIABLE, Policy.History.KeepLast(1000), Policy.DataRepresentation(use_cdrv0_representation=True)),
            )
            for name in ("labelled", "static")
        }

    def writer(self, name, kind, reliability, durability=Policy.Durability.Volatile):
        representation = Policy.DataRepresentation(use_cdrv0_representation=True)
        qos = Qos(reliability, durability, Policy.History.KeepLast(10), representation)
        return DataWriter(self.participant, Topic(self.participant, name, kind), qos)

    def wait(self, what) -> None:
        end = time.monotonic() + LONGEST
        while not what():
            assert time.monotonic() < end, "nobody came"
            time.sleep(0.02)


def replay(drive: str, answers: str, domain: int, poses: str) -> None:
    """Wait for somebody, publish the first scan, wait for its answer, then publish the others, ten a second."""
    given = dict(np.load(drive))
    mount = given["mount"]
    system = System(domain)
    system.tf_static.write(transforms(mount, time.time(), "base_link", "lidar"))
    system.wait(lambda: system.clouds.get_matched_subscriptions())
    system.wait(lambda: all(one.get_matched_publications() for one in system.answers.values()))
    time.sleep(0.3)
    took: dict[str, list[PointCloud2]] = {"labelled": [], "static": []}

    def answered() -> bool:
        for name, reader in system.answers.items():
            took[name] += [one for one in reader.take(N=100) if isinstance(one, PointCloud2)]
        return bool(took["static"])

    stamps = []
    for index, pose in enumerate(given["poses"]):
        began = time.monotonic()
        stamps.append(time.time())
        if poses == "tf":
            system.tf.write(transforms(pose @ np.linalg.inv(mount), stamps[-1], "odom", "base_link"))
        elif poses == "odometry":
            system.odometry.write(odometry(pose @ np.linalg.inv(mount), stamps[-1], "odom", "base_link"))
        system.clouds.write(cloud(given[f"scan_{index}"], stamps[-1]))
        if index == 0:
            system.wait(answered)
        time.sleep(max(0.0, PERIOD - (time.monotonic() - began)))
    time.sleep(1.0)
    answered()
    found = {"stamps": np.array(stamps)}
    for name, messages in took.items():
        for number, message in enumerate(messages):
            stamp = message.header.stamp
            found[f"{name}_{number}_stamp"] = np.float64(stamp.sec + 1e-9 * stamp.nanosec)
            assert message.header.frame_id == "lidar"
            for field, values in columns(message).items():
                found[f"{name}_{number}_{field}"] = values
    np.savez(answers, **found)


if __name__ == "__main__":
    os.environ.setdefault("CYCLONEDDS_URI", ALONE)
    replay(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4])
