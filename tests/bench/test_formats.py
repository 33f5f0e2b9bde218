"""The benchmark of both formats on a lake, and its counting of bytes."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")
pytest.importorskip("yaml")

from breplake.bench.speed import formats


def test_both_formats_answer_alike(tiny_lake, capsys):
    formats.main(tiny_lake, models=3, rounds=1)
    said = capsys.readouterr().out
    assert "with labels: 12\n" in said  # triangles of a box
    assert "tori in all models: 0\n" in said
    assert said.count("ABC's files") == said.count("breplake  ") == 2


def test_bytes_that_were_read_are_counted(tmp_path):
    if not formats._bytes_read():
        pytest.skip("no /proc/self/io")
    path = tmp_path / "file"
    path.write_bytes(bytes(50_000))
    before = formats._bytes_read()
    path.read_bytes()
    assert 50_000 <= formats._bytes_read() - before < 150_000


def test_answers_that_differ_are_an_error():
    with pytest.raises(RuntimeError, match="1 in ABC's files, 2 in the lake"):
        formats._print("tori", (1, 1.0, 1), (2, 1.0, 1))
