"""One vehicle's parameters: what is put into force, kept and undone."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from mavins.config import Config, load, to_yaml
from mavins.errors import ParameterError
from mavins.parameters import ConfigStore, file_keeper
from mavins.parameters import store as store_module


class Bench:
    """A store, and what it has put into force."""

    def __init__(self, path: Path | None = None, config: Config | None = None) -> None:
        self.applied: list[Config] = []
        self.store = ConfigStore(config or Config(), self.applied.append, file_keeper(path))


def test_a_live_parameter_is_in_force_at_once() -> None:
    b = Bench()
    assert b.store.set("GNSS_GATE", 4.0) == ""
    assert b.store.value("GNSS_GATE") == 4.0
    assert [c.gnss.gate for c in b.applied] == [4.0]
    assert b.store.set("GNSS_GATE", 4.0) == ""
    assert len(b.applied) == 1


def test_one_that_needs_a_restart_is_kept_and_said() -> None:
    b = Bench()
    assert "restart" in b.store.set("IMU_DELAY", 0.01)
    assert b.store.value("IMU_DELAY") == pytest.approx(0.01)
    assert b.applied == []


def test_what_is_refused_changes_nothing() -> None:
    b = Bench()
    with pytest.raises(ParameterError):
        b.store.set("GNSS_GATE", -1.0)
    with pytest.raises(ParameterError):
        b.store.set("NO_SUCH", 1.0)
    assert b.store.config == Config()
    assert b.applied == []


def test_an_objection_is_a_refusal() -> None:
    store = ConfigStore(Config(), lambda c: None, file_keeper(None), lambda c: f"no {c.filter}")
    assert store.refuses("FILTER", 2.0)
    assert not store.refuses("FILTER", 0.0)
    with pytest.raises(ParameterError, match="FILTER: no iekf"):
        store.set("FILTER", 2.0)
    assert store.config == Config()


def test_saving_writes_what_the_next_start_reads(tmp_path: Path) -> None:
    path = tmp_path / "mavins.yaml"
    path.write_text("gnss:\n  gate: 3.0  # mine\n")
    path.chmod(0o640)
    b = Bench(path, load(path))
    b.store.set("IMU_DELAY", 0.01)
    b.store.set("HDG_RATE_MAX", 2.5)
    assert b.store.save() == ""
    assert load(path) == b.store.config
    assert load(path).gnss.gate == 3.0
    assert path.read_text() == to_yaml(b.store.config)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert [p.name for p in tmp_path.iterdir()] == ["mavins.yaml"]


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    target = tmp_path / "real.yaml"
    target.write_text("")
    link = tmp_path / "link.yaml"
    link.symlink_to(target)
    b = Bench(link)
    b.store.set("GNSS_GATE", 4.0)
    assert b.store.save() == ""
    assert link.is_symlink()
    assert load(target).gnss.gate == 4.0


def test_without_a_file_saving_says_how_to_have_one() -> None:
    b = Bench()
    b.store.set("GNSS_GATE", 4.0)
    assert "--config FILE" in b.store.save()


def test_a_file_that_cannot_be_written_is_left_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mavins.yaml"
    path.write_text("gnss: {gate: 3.0}\n")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store_module.os, "fsync", full)
    b = Bench(path)
    b.store.set("GNSS_GATE", 4.0)
    assert b.store.save() == f"cannot write {path}: No space left on device"
    assert path.read_text() == "gnss: {gate: 3.0}\n"
    assert os.listdir(tmp_path) == ["mavins.yaml"]


def test_a_folder_that_is_gone_is_a_reason(tmp_path: Path) -> None:
    b = Bench(tmp_path / "gone" / "mavins.yaml")
    assert "cannot write" in b.store.save()


def test_the_way_back(tmp_path: Path) -> None:
    b = Bench(tmp_path / "mavins.yaml")
    b.store.set("GNSS_GATE", 4.0)
    b.store.save()
    b.store.set("GNSS_GATE", 6.0)
    b.store.load()
    assert b.store.value("GNSS_GATE") == 4.0
    b.store.load()
    b.store.reset()
    assert b.store.value("GNSS_GATE") == 5.0
    assert [c.gnss.gate for c in b.applied] == [4.0, 6.0, 4.0, 5.0]


def test_what_was_not_saved_is_not_gone_back_to() -> None:
    b = Bench()
    b.store.set("GNSS_GATE", 4.0)
    b.store.save()
    b.store.load()
    assert b.store.value("GNSS_GATE") == 5.0
