"""Network address of a compute cluster, with a check that connections to it are encrypted or local."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

from planning.errors import RequestError
from twin.cluster.certificates import Certificates

DEFAULT_PORT = 8786
"""Default port of a scheduler, the same as that of Dask."""

_NO_NETWORK = ("inproc",)


@dataclass(frozen=True)
class Cluster:
    """Address of a Dask scheduler with the certificates to connect.

    Attributes:
        address: such as ``tls://10.0.0.1:8786``.
        certificates: for ``tls://``.
        insecure: send plans, results and code without encryption to other machines.

    Raises:
        RequestError: it would be spoken to in the clear beyond this machine, or the
            certificates do not fit the address.
    """

    address: str
    certificates: Certificates | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        if encrypted(self.address):
            if self.certificates is None:
                raise RequestError(
                    f"{self.address} wants certificates: give their folder with"
                    " --certificates (twin cluster certificates DIR makes one)"
                )
        elif self.certificates is not None:
            raise RequestError(
                f"{self.address} is not encrypted and knows no certificates:"
                f" is it tls://{self.address.rpartition('://')[2]}?"
            )
        self.require_private(self.address)

    def require_private(self, address: str) -> None:
        """Raise a RequestError if others could eavesdrop on an address or connect to it."""
        if self.insecure or encrypted(address) or on_this_machine(address):
            return
        raise RequestError(
            f"{address} is not encrypted and not on this machine: whoever reaches it runs"
            " code on it; use tls:// with --certificates, or take the risk with"
            " --insecure"
        )


def encrypted(address: str) -> bool:
    """Return whether an address uses mutual TLS."""
    return address.startswith("tls://")


def on_this_machine(address: str) -> bool:
    """Return whether only this machine reaches an address; names but localhost are not resolved."""
    scheme, _, rest = address.rpartition("://")
    if scheme in _NO_NETWORK:
        return True
    has_port = rest.count(":") == 1 or "]:" in rest
    host = rest.rpartition(":")[0] if has_port else rest
    return host == "localhost" or is_loopback(host.strip("[]"))


def is_loopback(host: str) -> bool:
    """Return whether a numeric address is one of the loopback interface."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
