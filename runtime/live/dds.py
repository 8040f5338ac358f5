"""Topics of ROS 2 over DDS, without an installation of ROS (package `cyclonedds`).

https://design.ros2.org/articles/topic_and_service_names.html says what topics and types are called in DDS. Messages
stay as they were serialised; `rosbags` knows what they hold.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from threading import Event, Thread
from typing import Any, Self

from runtime.compute.packages import CYCLONEDDS, ROSBAGS, need_package
from runtime.errors import OutputError, ScanError, SettingError
from runtime.recordings.old_rosbags import is_old

PREFIX = "rt"  # of the names of topics, before their slash
WAIT = 100  # ms, after which a thread looks whether it is to end
BLOCK = 50  # ms that a slow subscriber may hold up a publication
KEPT = 100  # messages that may wait, but for clouds
CLOUDS_KEPT = 5
MANY = 10_000  # publishers
LARGEST_DOMAIN = 232
# Clouds go in many datagrams: the largest there are, as Fast DDS sends them, which in thousands of small ones loses
# clouds itself; and a buffer that holds more than the system's usual one
CONFIGURATION = (
    "<CycloneDDS><Domain><General><MaxMessageSize>65500B</MaxMessageSize><FragmentSize>60000B</FragmentSize></General>"
    "<Internal><SocketReceiveBufferSize max='32MB'/></Internal></Domain></CycloneDDS>"
)
CONFIGURED = "CYCLONEDDS_URI"  # the environment's own configuration, which then counts
PLAIN = {"string": str, "bool": bool}  # types that Python has


@dataclass(frozen=True)
class Quality:
    """How messages of a topic are to come. What is wanted may not be more than what is offered."""

    reliable: bool = True  # what gets lost is sent again
    latched: bool = False  # who comes later gets the last ones too
    kept: int = KEPT  # messages that wait for who is slow


SENSOR = Quality(reliable=False, kept=CLOUDS_KEPT)
CLOUDS = Quality(kept=CLOUDS_KEPT)


class Carried:
    """A message of DDS as it is serialised, in CDR with its four bytes of header."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def serialize(self, **_: Any) -> bytes:
        return self.data

    @classmethod
    def deserialize(cls, data: bytes, **_: Any) -> Self:
        return cls(data)

    @classmethod
    def deserialize_key(cls, data: bytes, **_: Any) -> None:
        return None


class Node:
    """What takes part in a DDS domain: it subscribes and publishes until it is closed."""

    def __init__(self, domain: int = 0) -> None:
        """domain: ROS_DOMAIN_ID. Raises SettingError, MissingPackageError, OutputError where DDS does not start."""
        for package in (CYCLONEDDS, ROSBAGS):
            need_package(package, "a ROS 2 system")
        if not 0 <= domain <= LARGEST_DOMAIN:
            raise SettingError(f"`domain` must be 0 to {LARGEST_DOMAIN}, not {domain}")
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
        from cyclonedds.core import DDSException
        from cyclonedds.domain import Domain, DomainParticipant
        from rosbags.typesys import Stores, get_typestore

        self.types = get_typestore(Stores.ROS2_HUMBLE)  # what messages hold
        try:
            self._domain = None if os.environ.get(CONFIGURED) else Domain(domain, CONFIGURATION)
            self._participant = DomainParticipant(domain)
            self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        except DDSException as error:
            raise OutputError(f"cannot take part in DDS domain {domain}: {error.msg}; see {CONFIGURED}") from error
        self._takers: list[tuple[Any, Callable[[bytes], object]]] = []
        self._writers, self._topics = list[Any](), list[Any]()
        self._lost: dict[str, int] = {}
        self._stop, self._failed = Event(), list[BaseException]()
        self._thread = Thread(target=self._receive, name="dds", daemon=True)
        self.idl = cache(self._idl)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def offered(self) -> dict[str, tuple[str, bool]]:
        """Topics of ROS that somebody publishes: the type of each, and whether reliably."""
        from cyclonedds.qos import Policy

        found: dict[str, tuple[str, bool]] = {}
        for one in self._publications.read(N=MANY):
            name = getattr(one, "topic_name", "")
            if name.startswith(f"{PREFIX}/"):
                topic, reliable = name.removeprefix(PREFIX), Policy.Reliability.BestEffort not in one.qos
                kind = one.type_name.replace("::dds_::", "/").replace("::", "/").removesuffix("_")
                found[topic] = kind, reliable and found.get(topic, ("", True))[1]
        return found

    def subscribe(self, topic: str, kind: str, quality: Quality, take: Callable[[bytes], object]) -> None:
        """Have every message of a topic handed to `take`, in the thread of the node, once it was started."""
        from cyclonedds.core import Listener
        from cyclonedds.sub import DataReader

        def count(_: Any, status: Any) -> None:
            self._lost[topic] = status.total_count

        counting = Listener(on_sample_lost=count)
        reader = DataReader(self._participant, self._topic(topic, kind), self._qos(kind, quality), counting)
        self._takers.append((reader, take))

    def lost(self, topic: str) -> int:
        """Messages that were sent and did not come."""
        return self._lost.get(topic, 0)

    def publisher(self, topic: str, kind: str, quality: Quality) -> Callable[[bytes], bool]:
        """What publishes messages on a topic; False where somebody was too slow to take one. Raises OutputError."""
        from cyclonedds.core import DDSException
        from cyclonedds.pub import DataWriter

        writer = DataWriter(self._participant, self._topic(topic, kind), qos=self._qos(kind, quality))
        self._writers.append(writer)
        carried = self.idl(kind)

        def publish(data: bytes) -> bool:
            try:
                writer.write(carried(data))
            except DDSException as error:
                if error.code == DDSException.DDS_RETCODE_TIMEOUT:
                    return False
                raise OutputError(f"cannot publish on {topic}: {error.msg}") from error
            return True

        return publish

    def start(self) -> None:
        """From now on messages are taken."""
        self._thread.start()

    def check(self) -> None:
        """Raises what a taker has raised."""
        if self._failed:
            raise self._failed[0]

    def close(self) -> None:
        """Take no more messages, and leave the domain."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        readers = [reader for reader, _ in self._takers]
        for one in (*readers, *self._writers, *self._topics, self._publications, self._participant, self._domain):
            if one is not None:
                one.__del__()  # the only way of `cyclonedds` to leave before the process ends
        self._takers.clear()

    def decoded(self, data: bytes, kind: str, where: str) -> Any:
        """The content of a message. Raises ScanError, beginning with `where`."""
        try:
            return self.types.deserialize_cdr(data, kind)
        except Exception as error:  # of rosbags, of NumPy: there is no common base
            raise ScanError(f"{where}: cannot be read as {kind}: {type(error).__name__}: {error}") from error

    def encoded(self, content: Any, kind: str) -> bytes:
        """A message as it is carried."""
        return bytes(self.types.serialize_cdr(content, kind))

    def _receive(self) -> None:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
        from cyclonedds.util import duration

        try:
            waiting = WaitSet(self._participant)
            for reader, _ in self._takers:
                waiting.attach(ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any))
            while not self._stop.is_set():
                waiting.wait(duration(milliseconds=WAIT))
                for reader, take in self._takers:
                    for sample in reader.take(N=KEPT):
                        if isinstance(sample, reader.topic.data_type):  # else it says that a publisher has gone
                            take(sample.data)
        except BaseException as error:  # is raised where it is noticed
            self._failed.append(error)

    def _topic(self, topic: str, kind: str) -> Any:
        from cyclonedds.topic import Topic

        self._topics.append(Topic(self._participant, PREFIX + topic, self.idl(kind)))
        return self._topics[-1]

    def _qos(self, kind: str, quality: Quality) -> Any:
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.util import duration

        reliable = Policy.Reliability.Reliable(duration(milliseconds=BLOCK))
        return Qos(
            reliable if quality.reliable else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if quality.latched else Policy.Durability.Volatile,
            Policy.History.KeepLast(quality.kept),
            Policy.DataRepresentation(use_cdrv0_representation=True),  # the one that ROS speaks
            Policy.Userdata(f"typehash={self.types.hash_rihs01(kind)};".encode()),  # ROS asks for it from Iron on
        )

    def _idl(self, kind: str) -> Any:
        """The type of DDS of a message of ROS, as `pkg/msg/Name`."""
        from cyclonedds.idl import make_idl_struct

        package, _, name = kind.split("/")
        definitions = self.types.FIELDDEFS if is_old() else self.types.fielddefs
        fields = {field: self._of(*described) for field, described in definitions[kind][1]}
        struct = make_idl_struct(f"{name}_", f"{package}.msg.dds_.{name}_", fields, dataclassify=False)
        for method, value in vars(Carried).items():
            if method in ("__init__", "serialize", "deserialize", "deserialize_key"):
                setattr(struct, method, value)
        return struct

    def _of(self, node: int, described: Any) -> Any:
        """The type of a field."""
        from cyclonedds.idl import types
        from rosbags.interfaces import Nodetype

        if node == Nodetype.NAME:
            return self.idl(described)
        if node == Nodetype.BASE:
            return PLAIN.get(described[0]) or getattr(types, described[0])
        within = self._of(*described[0])
        return types.array[within, described[1]] if node == Nodetype.ARRAY else types.sequence[within]
