"""Who listens on this machine."""

import socket
from pathlib import Path


def listening() -> set[tuple[str, int]]:
    """Return the addresses and ports at which processes of this machine listen, as its kernel says."""
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path("/proc/net", table).read_text().splitlines()[1:]:
            _, local, _, state, *_ = line.split()
            if state == "0A":
                host, port = local.split(":")
                # An address of version 4 is the end of one of version 6.
                number = socket.inet_ntoa(bytes.fromhex(host[-8:])[::-1])
                found.add((number, int(port, 16)))
    return found
