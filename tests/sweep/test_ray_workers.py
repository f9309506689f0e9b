"""The same rows by workers of a Ray cluster."""

import pytest

from jaxlocomanip import cli
from jaxlocomanip.sweep.store import read_manifest, read_results

pytest.importorskip("ray")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of Ray, which is not this project's to mend
def test_two_workers_give_the_rows_of_one_process(tiny_study, quick_config, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(tiny_study)
    (tmp_path / "quick.toml").write_text(quick_config)
    command = ["sweep", "tiny.toml", "--config", "quick.toml", "--out"]
    assert cli.main([*command, "alone"]) == 0
    assert cli.main([*command, "together", "--workers", "ray:2"]) == 0
    assert read_results("together").equals(read_results("alone"))
    assert read_manifest("together")["workers"] == 2
    assert read_manifest("together")["settings"] == read_manifest("alone")["settings"]
