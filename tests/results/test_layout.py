import json

import pytest

from tma_ray.results import Committer, Results, ResultsRootError, Store, check_id, create_root


def test_an_empty_place_becomes_a_root_once(store: Store) -> None:
    create_root(store)
    content = store.read_bytes("root.json")
    create_root(store)
    assert store.read_bytes("root.json") == content


def test_a_kill_before_the_root_is_made_does_not_spoil_it(store: Store) -> None:
    store.write_bytes(store.temporary(), b"{")
    create_root(store)
    assert store.exists("root.json")


def test_other_files_are_never_taken_for_a_root(store: Store) -> None:
    store.write_bytes("thesis.tex", b"")
    with pytest.raises(ResultsRootError, match=r"thesis\.tex"):
        Committer(store)
    with pytest.raises(ResultsRootError, match="not a results root"):
        Results(store)
    assert store.files() == ("thesis.tex",)


def test_another_version_is_refused_naming_both(store: Store) -> None:
    content = {"format": "tma_ray results", "schema_version": 99}
    store.write_bytes("root.json", json.dumps(content).encode())
    for opens in (Committer, Results):
        with pytest.raises(ResultsRootError, match=r"version 99; .* version 1"):
            opens(store)


@pytest.mark.parametrize("content", [b"", b"[]", b"{}", b'{"format": "other", "schema_version": 1}'])
def test_a_damaged_or_foreign_root_file_is_refused(store: Store, content: bytes) -> None:
    store.write_bytes("root.json", content)
    with pytest.raises(ResultsRootError, match=r"root\.json"):
        Results(store)


@pytest.mark.parametrize("name", ["", "..", "a/b", "a.b", "a b", "é", "a\n"])
def test_ids_that_are_no_file_names_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="file names"):
        check_id(name)
