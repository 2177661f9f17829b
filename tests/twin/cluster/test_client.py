"""Which schedulers a study speaks to, with which certificates, and which workers it refuses."""

import shutil
import subprocess
from pathlib import Path

import pytest

from planning.errors import RequestError, TwinError
from twin.cluster.address import Cluster
from twin.cluster.certificates import certificates_in, make_certificates
from twin.cluster.client import ClusterError, require_same_versions


@pytest.mark.parametrize(
    "address",
    [
        "tcp://127.0.0.1:8786",
        "tcp://127.9.9.9:8786",
        "tcp://localhost:8786",
        "tcp://[::1]:8786",
        "127.0.0.1:8786",
        "127.0.0.1",
        "inproc://10.0.0.1/123/1",
    ],
)
def test_this_machine_may_be_spoken_to_in_the_clear(address: str) -> None:
    assert Cluster(address).address == address


@pytest.mark.parametrize(
    "address",
    [
        "tcp://10.0.0.1:8786",
        "10.0.0.1:8786",
        "tcp://0.0.0.0:8786",
        "tcp://[::]:8786",
        "tcp://[2001:db8::1]:8786",
        "tcp://example.org:8786",
        "tcp://localhost.example.org:8786",
        "tcp://127.0.0.1.example.org:8786",
        "ws://10.0.0.1:8786",
        "tcp://",
        "",
    ],
)
def test_other_machines_are_not_unless_one_insists(address: str) -> None:
    with pytest.raises(RequestError, match=r"not encrypted.*--insecure"):
        Cluster(address)
    Cluster(address, insecure=True)


def test_certificates_and_addresses_go_together(tmp_path: Path) -> None:
    held = make_certificates(tmp_path / "certs", 1)
    Cluster("tls://10.0.0.1:8786", held)
    with pytest.raises(RequestError, match="--certificates"):
        Cluster("tls://10.0.0.1:8786")
    with pytest.raises(RequestError, match=r"is it tls://10.0.0.1:8786"):
        Cluster("tcp://10.0.0.1:8786", held)


def test_the_key_of_certificates_is_for_one_user_alone(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "certs"
    held = make_certificates(folder, 1)
    assert sorted(path.name for path in folder.iterdir()) == [
        *("ca.pem", "cert.pem", "key.pem")
    ]
    assert [path.name for path in folder.parent.iterdir()] == ["certs"]
    assert folder.stat().st_mode & 0o777 == 0o700
    assert held.key.stat().st_mode & 0o777 == 0o600
    held.key.chmod(0o640)
    with pytest.raises(RequestError, match="chmod 600"):
        certificates_in(folder)


def test_openssl_takes_the_certificates_at_their_strictest(tmp_path: Path) -> None:
    held = make_certificates(tmp_path / "certs", 1)
    for purpose in ("sslclient", "sslserver"):
        subprocess.run(
            [
                *("openssl", "verify", "-x509_strict", "-purpose", purpose),
                *("-CAfile", held.authority, held.certificate),
            ],
            check=True,
            capture_output=True,
        )


def test_certificates_are_never_written_over(tmp_path: Path) -> None:
    held = make_certificates(tmp_path / "certs", 1)
    before = held.key.read_bytes()
    with pytest.raises(RequestError, match="is there already"):
        make_certificates(tmp_path / "certs", 1)
    assert held.key.read_bytes() == before


def test_missing_files_are_named(tmp_path: Path) -> None:
    held = make_certificates(tmp_path / "certs", 1)
    held.authority.unlink()
    with pytest.raises(RequestError, match=r"ca.pem is missing"):
        certificates_in(tmp_path / "certs")


def test_a_missing_openssl_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(TwinError, match="openssl, which is not on the PATH"):
        make_certificates(tmp_path / "certs", 1)
    assert not (tmp_path / "certs").exists()


HERE = {"python": "3.11.7", "numpy": "2.4.6", "scipy": "1.17.1"}
A, B = "tls://10.0.0.1:1", "tls://10.0.0.2:1"


def test_workers_with_the_same_versions_are_taken() -> None:
    require_same_versions({A: dict(HERE), B: {**HERE, "more": "1"}}, HERE)


def test_a_worker_with_another_version_is_named() -> None:
    without = {name: version for name, version in HERE.items() if name != "scipy"}
    with pytest.raises(ClusterError) as found:
        require_same_versions({A: HERE, B: {**without, "numpy": "2.4.5"}}, HERE)
    assert str(found.value) == (
        f"the worker at {B} has other versions, so results could differ:"
        " numpy is 2.4.5 there and 2.4.6 here, scipy is missing there and 1.17.1 here"
    )


def test_a_worker_without_the_package_is_named() -> None:
    missing = ModuleNotFoundError("No module named 'twin'")
    with pytest.raises(ClusterError, match=f"{B} cannot work .* No module named"):
        require_same_versions({A: HERE, B: missing}, HERE)
