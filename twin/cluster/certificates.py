"""TLS certificates of a compute cluster, required for every connection to it.

Certificates are created once and copied to all machines of the cluster. A folder contains a certificate authority,
one certificate signed by it, and the key of that certificate. The key of the authority is deleted, so no other
certificate can be signed. Everyone with a copy of the folder has access.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from planning.errors import OutputError, RequestError, TwinError

AUTHORITY, CERTIFICATE, KEY = "ca.pem", "cert.pem", "key.pem"
"""Files of a folder of certificates."""

_OPENSSL = """\
[req]
distinguished_name = name
prompt = no
[name]
CN = assembly-twin cluster
[authority]
basicConstraints = critical, CA:TRUE
keyUsage = critical, keyCertSign
subjectKeyIdentifier = hash
[member]
basicConstraints = critical, CA:FALSE
keyUsage = critical, digitalSignature
extendedKeyUsage = serverAuth, clientAuth
subjectKeyIdentifier = hash
authorityKeyIdentifier = keyid
"""
_NEW_KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


@dataclass(frozen=True)
class Certificates:
    """Certificate files of a machine of a cluster, for mutual authentication.

    Attributes:
        authority: certificate that has signed those of all members.
        certificate: of this machine; all may share one.
        key: private key of the certificate.
    """

    authority: Path
    certificate: Path
    key: Path


def certificates_in(folder: Path) -> Certificates:
    """Return the certificates in a folder.

    Raises:
        RequestError: a file is missing, or other users of this machine may read the key.
    """
    found = Certificates(folder / AUTHORITY, folder / CERTIFICATE, folder / KEY)
    for path in (found.authority, found.certificate, found.key):
        if not path.is_file():
            raise RequestError(
                f"{path} is missing: twin cluster certificates DIR makes a folder with"
                f" {AUTHORITY}, {CERTIFICATE} and {KEY}"
            )
    if found.key.stat().st_mode & 0o077:
        raise RequestError(
            f"{found.key} can be read by other users, who could use the cluster:"
            f" chmod 600 {found.key}"
        )
    return found


def make_certificates(folder: Path, days: int) -> Certificates:
    """Make an authority and a certificate for all machines of a cluster.

    Args:
        folder: made, with all folders above it; only this user may enter it.
        days: for so long they are valid.

    Raises:
        RequestError: there is something at the folder already.
        TwinError: the program ``openssl`` is missing, or fails.
        OutputError: the folder cannot be written.
    """
    if folder.exists():
        raise RequestError(
            f"{folder} is there already; members of a cluster need the same certificates,"
            " so give a new folder for new ones"
        )
    if shutil.which("openssl") is None:
        raise TwinError(
            "certificates are made by the program openssl, which is not on the PATH:"
            " install the package openssl"
        )
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
            made = Path(scratch) / "made"
            made.mkdir(mode=0o700)
            _sign(Path(scratch), made, days)
            (made / KEY).chmod(0o600)
            made.rename(folder)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error}") from error
    return certificates_in(folder)


def _sign(scratch: Path, made: Path, days: int) -> None:
    config, authority_key, request = (
        *(scratch / "openssl.cnf", scratch / "ca-key.pem", scratch / "request.pem"),
    )
    config.write_text(_OPENSSL, encoding="utf-8")
    valid = ("-days", str(days))
    _openssl(
        *("req", "-x509", "-config", config, "-extensions", "authority", *valid),
        *(*_NEW_KEY, "-keyout", authority_key, "-out", made / AUTHORITY),
    )
    _openssl(
        *("req", "-new", "-config", config, *_NEW_KEY),
        *("-keyout", made / KEY, "-out", request),
    )
    _openssl(
        *("x509", "-req", "-in", request, "-out", made / CERTIFICATE, *valid),
        *("-CA", made / AUTHORITY, "-CAkey", authority_key, "-CAcreateserial"),
        *("-CAserial", scratch / "serial"),
        *("-extfile", config, "-extensions", "member"),
    )


def _openssl(*arguments: str | Path) -> None:
    done = subprocess.run(
        ["openssl", *map(str, arguments)], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise TwinError(f"openssl {arguments[0]} failed: {last}")
