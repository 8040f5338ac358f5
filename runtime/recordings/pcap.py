"""Captured network traffic (.pcap): what a sensor sent, packet by packet.

https://www.ietf.org/archive/id/draft-ietf-opsawg-pcap-04.html
"""

import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from runtime.errors import MosWarning, SequenceError
from runtime.files import open_ordinary

SUFFIX = ".pcap"
ORDERS = {b"\xd4\xc3\xb2\xa1": ("<", 1e-6), b"\xa1\xb2\xc3\xd4": (">", 1e-6)}  # byte order, unit of time in s
ORDERS |= {b"\x4d\x3c\xb2\xa1": ("<", 1e-9), b"\xa1\xb2\x3c\x4d": (">", 1e-9)}
NEXT_GENERATION = b"\x0a\x0d\x0d\x0a"
HEAD, RECORD = 24, 16  # bytes, of the file and before each packet
IPV4, UDP, VLAN = b"\x08\x00", 17, (b"\x81\x00", b"\x88\xa8")
LINKS = {0: 4, 1: 14, 101: 0, 113: 16, 228: 0, 276: 20}  # bytes before the IP packet, by the kind of network
LARGEST = 1 << 18  # bytes of a packet
FIRST = 200  # packets by which a file tells whose they are
VELODYNE = 1206  # bytes of a packet of points of Velodyne's sensors, and of no other that is read here


@dataclass(frozen=True)
class Packet:
    """What was sent by UDP over IPv4."""

    time: float  # s, when it was captured
    at: int  # byte in the file at which it begins
    sender: bytes  # its address, 4 bytes
    size: int  # bytes sent, also of a packet that came in several parts
    payload: bytes


def is_pcap(path: Path) -> bool:
    """Whether a file is one, by its name."""
    return path.suffix.lower() == SUFFIX and path.is_file()


def is_velodyne(path: Path) -> bool:
    """Whether some of the first packets of a .pcap are those of Velodyne. Raises SequenceError where there is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MosWarning)  # is said when it is opened
        first = list(islice(packets(path), FIRST))
    if not first:
        raise SequenceError(f"{path}: holds no packet that was sent by UDP")
    return any(packet.size == VELODYNE for packet in first)


def packets(path: Path, start: int = HEAD) -> Iterator[Packet]:
    """The packets of a file from byte `start` on; others than UDP are left out.

    Raises SequenceError where it is no such file; warns (MosWarning) where it is cut off, and ends there.
    """
    with _opened(path) as file:
        link, records = _records(file, start, path)
        for time, at, size in records:
            if (found := _udp(file.read(size), link)) is not None:
                yield Packet(time, at, *found)


def count_packets(path: Path) -> int:
    """Of all kinds; a second for a million. Raises and warns as `packets`."""
    with _opened(path) as file:
        return sum(1 for _ in _records(file, HEAD, path)[1])


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with open_ordinary(path) as file:
            yield file
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read: {error.strerror}") from error


def _records(file: BinaryIO, start: int, path: Path) -> tuple[int, Iterator[tuple[float, int, int]]]:
    """The kind of network; time in s, place and bytes of each packet, whose content the file is at meanwhile."""
    head = file.read(HEAD)
    if head[:4] == NEXT_GENERATION:
        raise SequenceError(f"{path}: is of the format pcapng: `editcap -F pcap` (of Wireshark) makes it pcap")
    if head[:4] not in ORDERS or len(head) < HEAD:
        raise SequenceError(f"{path}: is no pcap file: it does not begin as one")
    order, unit = ORDERS[head[:4]]
    link = struct.unpack(order + "I", head[20:])[0] & 0xFFFF
    if link not in LINKS:
        raise SequenceError(f"{path}: holds traffic of an unknown kind of network, {link}")
    end = path.stat().st_size

    def records() -> Iterator[tuple[float, int, int]]:
        at = start
        while at < end:
            file.seek(at)
            record = file.read(RECORD)
            kept = struct.unpack(order + "I", record[8:12])[0] if len(record) == RECORD else LARGEST
            if at + RECORD + kept > end:
                warnings.warn(
                    f"{path}: is cut off, or damaged, at byte {at} of {end}: what is before that is read",
                    MosWarning,
                    stacklevel=2,
                )
                return
            seconds, parts = struct.unpack(order + "2I", record[:8])
            yield seconds + parts * unit, at, kept
            at += RECORD + kept

    return link, records()


def _udp(data: bytes, link: int) -> tuple[bytes, int, bytes] | None:
    """Sender, size and payload of the first part of a UDP packet; None where it is something else."""
    at = LINKS[link]
    if link == 1:
        while data[at - 2 : at] in VLAN:
            at += 4
        if data[at - 2 : at] != IPV4:
            return None
    ip = data[at:]
    if len(ip) < 20 or ip[0] >> 4 != 4 or ip[9] != UDP or (ip[6] & 0x1F) << 8 | ip[7]:  # not the first part
        return None
    udp = ip[4 * (ip[0] & 15) :]
    if len(udp) < 8:
        return None
    length = int.from_bytes(udp[4:6], "big")
    return ip[12:16], length - 8, udp[8:length]
