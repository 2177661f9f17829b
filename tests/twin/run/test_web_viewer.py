"""The viewer in a browser: who listens, and that a run that is followed gets there."""

from __future__ import annotations

import subprocess
import sys
import urllib.request

from tests.twin.sockets import listening

CODE = """
import sys, time, urllib.request
from twin.run.viewer import web_viewer
address, page = web_viewer()
print(address, page, flush=True)
sys.stdin.readline()
"""


def test_the_viewer_is_served_to_this_machine_only_and_ends_with_the_program() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", CODE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        address, page = process.stdout.readline().split()
        ports = {int(address.split(":")[2].split("/")[0])}
        ports.add(int(page.split(":")[2].split("/")[0]))
        assert len(ports) == 2
        hosts = {host for host, port in listening() if port in ports}
        assert hosts == {"127.0.0.1"}
        with urllib.request.urlopen(page, timeout=20) as answer:
            assert b"<html" in answer.read().lower()
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.wait(timeout=20) == 0
    for _ in range(50):
        if not {port for _, port in listening()} & ports:
            break
        subprocess.run(["sleep", "0.1"], check=True)
    assert not {port for _, port in listening()} & ports
