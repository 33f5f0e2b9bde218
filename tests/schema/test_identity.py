"""Ids of models depend on nothing but their names."""

from __future__ import annotations

import hashlib

import pytest

from breplake.errors import UsageError
from breplake.schema.identity import model_id


def test_id_is_the_first_63_bits_of_the_hash():
    digest = hashlib.sha256(b"abc/00000050_80d90bfdd2e74e709956122a_000").hexdigest()
    bits = bin(int(digest, 16))[2:].zfill(256)[:63]
    assert model_id("abc", "00000050_80d90bfdd2e74e709956122a_000") == int(bits, 2)


def test_ids_fit_int64_and_differ():
    ids = {model_id("c", str(i)) for i in range(1000)}
    assert len(ids) == 1000
    assert all(0 <= i < 2**63 for i in ids)


def test_names_that_are_not_utf8_are_named():
    assert model_id("c", "a\udcff") != model_id("c", "a\udcfe")


@pytest.mark.parametrize(("collection", "name"), [("", "a"), ("a", ""), ("a/b", "c")])
def test_ambiguous_names_are_refused(collection, name):
    with pytest.raises(UsageError):
        model_id(collection, name)
