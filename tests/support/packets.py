"""Captured packets of Velodyne, written as a network would have carried them."""

import struct
from pathlib import Path

ETHERNET = bytes(12) + b"\x08\x00"


def write_pcap(path, packets, sender=b"\xc0\xa8\x01\xc9", order="<", link=1, before=ETHERNET):
    """packets: time in s and payload of each."""
    with path.open("wb") as file:
        file.write(struct.pack(order + "IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link))
        for time, payload in packets:
            udp = struct.pack(">HHHH", 2368, 2368, 8 + len(payload), 0) + payload
            ip = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0) + sender + b"\xff" * 4
            data = before + ip + udp
            file.write(struct.pack(order + "IIII", int(time), round(time % 1 * 1e6), len(data), len(data)) + data)
    return path


def write_vlp16(path: Path, turns: float = 3.0) -> Path:
    """A VLP-16 at 10 Hz amid a round wall, 20 m away (by the packets of its manual)."""
    packets = []
    for number in range(round(turns * 36)):
        blocks = b""
        for block in range(12):
            azimuth = (number * 12 + block) * 83 % 36000  # hundredths of a degree
            blocks += struct.pack("<HH", 0xEEFF, azimuth) + struct.pack("<HB", 10_000, 100) * 32
        time = number * 0.1 / 36
        packets.append((1e9 + time, blocks + struct.pack("<IBB", round(1e6 * time), 0x37, 0x22)))
    return write_pcap(path, packets)
