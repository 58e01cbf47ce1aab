"""Which addresses processes listen on, as Linux tells it."""

from __future__ import annotations

import ipaddress
from pathlib import Path

LISTEN = "0A"
PROC = Path("/proc")


def family(pid: int) -> list[int]:
    """A process and all that it has started, and they."""
    parents = {}
    for path in PROC.glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
        except OSError:  # it has ended
            continue
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def listening(*pids: int) -> list[str]:
    """HOST:PORT of every TCP socket that the processes and their descendants listen on."""
    inodes = set()
    for member in {member for pid in pids for member in family(pid)}:
        for link in (PROC / str(member) / "fd").glob("*"):
            try:
                inodes.add(str(link.readlink()))
            except OSError:
                continue
    rows = [line.split() for name in ("tcp", "tcp6") for line in (PROC / "net" / name).read_text().splitlines()[1:]]
    return [_address(row[1]) for row in rows if row[3] == LISTEN and f"socket:[{row[9]}]" in inodes]


def _address(text: str) -> str:
    """`0100007F:1F90` is 127.0.0.1:8080; words of four bytes are little-endian."""
    host, port = text.split(":")
    words = b"".join(bytes.fromhex(host[i : i + 8])[::-1] for i in range(0, len(host), 8))
    address = ipaddress.ip_address(words)
    mapped = getattr(address, "ipv4_mapped", None)
    return f"{mapped or address}:{int(port, 16)}"
