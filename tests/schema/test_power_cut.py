"""A snapshot is on the disk only after all files that it names."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from breplake.schema.lake import LakeStore
from breplake.schema.storage import folder_files


def test_files_are_on_the_disk_before_the_snapshot_that_names_them(
    tiny_lake: Path, tmp_path: Path, monkeypatch
):
    made = LakeStore.open(tiny_lake)
    head = made.head()
    store = LakeStore.create(tmp_path / "lake", made.lake_id)
    for folder in ("tables", "arrays"):
        shutil.copytree(tiny_lake / folder, store.root / folder)
    synced: list[tuple[str, bool]] = []
    really = os.fsync

    def fsync(descriptor: int) -> None:
        path = os.readlink(f"/proc/self/fd/{descriptor}")
        synced.append((path, bool(store.numbers())))
        really(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    store.commit(head.files, message="m", tools={}, config_hash="")
    before = {path for path, is_named in synced if not is_named}
    root = store.root
    files = {str(root / f) for f in folder_files(root) if f.startswith(("tables/", "arrays/"))}
    assert files
    assert files <= before
    assert {str(Path(file).parent) for file in files} | {str(root)} <= before
    assert any("/snapshots/" in path for path in before)  # the document, before it has its name
    assert (str(root / "snapshots"), True) in synced
    assert not [name for name in folder_files(root) if "#" in name]
