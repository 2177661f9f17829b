"""Designs that a cluster evaluates: the same as here, and files must be where its workers are."""

import pickle
import zlib
from dataclasses import replace
from pathlib import Path

import pytest

import twin
from tests.twin.cluster.processes import up
from tests.twin.explorations.bench import setting_of
from tests.twin.explorations.sliders import slider_file
from twin.cluster.client import ClusterError
from twin.explorations.crew import DesignTask, evaluate_on_worker
from twin.explorations.journal import Journal

pytest.importorskip("distributed")
pytest.importorskip("optuna")


@pytest.mark.nightly
def test_a_cluster_of_one_finds_what_one_process_finds(tmp_path: Path) -> None:
    file = slider_file(tmp_path / "scenario")
    here = twin.explore(file, designs=6, workers=1, out=tmp_path / "here")
    process, cluster = up(tmp_path)
    try:
        there = twin.explore(file, designs=6, cluster=cluster, out=tmp_path / "there")
    finally:
        process.kill()
        process.communicate()
    rows = [
        [(row.design, row.values, row.evaluation.goals) for row in Journal(place).rows]
        for place in (here.folder, there.folder)
    ]
    assert rows[0] == rows[1]
    assert len(rows[0]) >= 6


def test_files_must_be_where_the_workers_are(tmp_path: Path) -> None:
    setting = setting_of(slider_file(tmp_path))
    elsewhere = replace(setting, folder=tmp_path / "elsewhere")
    packed_setting = zlib.compress(pickle.dumps(elsewhere))
    with pytest.raises(ClusterError, match=r"slider\.urdf.*elsewhere on every machine"):
        evaluate_on_worker(packed_setting, 20.0, DesignTask(0, {}))
