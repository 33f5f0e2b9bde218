"""Folders behind links are searched like others, each of them once."""

from __future__ import annotations

import os

from breplake.ingest.inputs import find_inputs


def names(source):
    return [item.name for item in find_inputs([source]) if item.failure is None]


def put(folder, *files):
    folder.mkdir(parents=True, exist_ok=True)
    for name in files:
        (folder / name).write_text("bytes")
    return folder


def test_linked_folders_are_searched(tmp_path):
    far = put(tmp_path / "far", "c.step")
    put(far / "deep", "d.step")
    here = put(tmp_path / "here", "a.step")
    (here / "link").symlink_to(far)
    (here / "again").symlink_to("link")
    assert names(here) == ["a", "again/c", "again/deep/d"]
    (here / "again").unlink()
    assert names(here) == ["a", "link/c", "link/deep/d"]
    (tmp_path / "top").symlink_to(here)
    assert names(tmp_path / "top") == names(here)


def test_what_is_here_keeps_its_own_path(tmp_path):
    put(tmp_path / "here" / "z" / "deep", "a.step")
    (tmp_path / "here" / "a").symlink_to("z/deep")
    assert names(tmp_path / "here") == ["z/deep/a"]


def test_loops_end(tmp_path):
    here = put(tmp_path / "here", "a.step")
    put(here / "sub", "b.step")
    (here / "sub" / "up").symlink_to(here)
    (here / "self").symlink_to(".")
    (here / "knot").symlink_to("knot")
    assert names(here) == ["a", "sub/b"]
    far = put(tmp_path / "far", "c.step")
    (far / "back").symlink_to(here)
    (here / "far").symlink_to(far)
    assert names(here) == ["a", "far/c", "sub/b"]


def test_a_link_to_a_folder_that_cannot_be_listed_is_told(tmp_path, monkeypatch):
    far = put(tmp_path / "far", "c.step")
    here = put(tmp_path / "here", "a.step")
    (here / "link").symlink_to(far)
    whole = os.scandir

    def scandir(path):
        if str(path).endswith("link"):
            raise PermissionError(13, "Permission denied", str(path))
        return whole(path)

    monkeypatch.setattr(os, "scandir", scandir)
    assert {i.name: i.failure and i.failure.kind for i in find_inputs([here])} == {
        "a": None,
        "link/": "unreadable",
    }
