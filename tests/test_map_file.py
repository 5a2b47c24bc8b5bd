"""The map file: what is written is read again, and what is wrong with a file is said in one sentence."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from maps import small_map

from openvox.core.digest import map_digest
from openvox.core.errors import InputError, OutputError
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import LAYOUT, read_map, write_map
from openvox.formats.npz import FREE_BYTES, read_arrays


def members(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def changed(tmp_path: Path, name: str, value: Any) -> Path:
    """A map file in which one array is another (or missing, if None)."""
    good, bad = tmp_path / "good.map.npz", tmp_path / "bad.map.npz"
    write_map(good, small_map())
    arrays = members(good)
    del arrays[name]
    np.savez(bad, **arrays, **({} if value is None else {name: value}))
    return bad


def with_meta(tmp_path: Path, **changes: Any) -> Path:
    write_map(tmp_path / "m.npz", small_map())
    meta = json.loads(members(tmp_path / "m.npz")["meta"].tobytes())
    return changed(tmp_path, "meta", np.frombuffer(json.dumps({**meta, **changes}).encode(), np.uint8))


def test_a_map_comes_back_as_it_was(tmp_path: Path) -> None:
    before = small_map()
    write_map(tmp_path / "a.map.npz", before)
    after = read_map(tmp_path / "a.map.npz")
    for name in LAYOUT:
        assert np.array_equal(getattr(before, name), getattr(after, name)), name
        assert getattr(after, name).dtype == LAYOUT[name][0]
    assert after.instances == before.instances
    assert (after.voxel_size, after.vote_unit) == (0.04, 0.5)
    assert {**after.meta} == {**before.meta, "format_version": 1, "openvox_version": after.meta["openvox_version"]}
    assert {name: array.tolist() for name, array in after.state.items()} == {"next_id": [8], "pairs": [[2, 5, 1]]}
    assert map_digest(after) == map_digest(before)


def test_equal_maps_give_equal_bytes_that_need_no_openvox_to_be_read(tmp_path: Path) -> None:
    write_map(tmp_path / "a.map.npz", small_map())
    write_map(tmp_path / "b.map.npz", small_map())
    assert (tmp_path / "a.map.npz").read_bytes() == (tmp_path / "b.map.npz").read_bytes()
    arrays = members(tmp_path / "a.map.npz")
    assert {*LAYOUT, "meta"} <= arrays.keys()
    assert arrays["meta"].dtype == np.uint8
    assert json.loads(arrays["meta"].tobytes())["instances"]["5"]["caption"] == "ein grüner Stuhl"
    with zipfile.ZipFile(tmp_path / "a.map.npz") as archive:
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_arrays_may_be_packed_or_lie_in_another_order(tmp_path: Path) -> None:
    write_map(tmp_path / "a.map.npz", small_map())
    arrays = members(tmp_path / "a.map.npz")
    arrays["voxel_index"] = np.asfortranarray(arrays["voxel_index"])
    np.savez_compressed(tmp_path / "b.map.npz", **dict(reversed(arrays.items())), later_addition=np.arange(3))
    assert map_digest(read_map(tmp_path / "b.map.npz")) == map_digest(small_map())


def test_an_empty_map_comes_back(tmp_path: Path) -> None:
    full = small_map()
    empty = replace(
        full,
        **{f.name: getattr(full, f.name)[:0] for f in fields(InstanceMap) if f.name in LAYOUT},
        instances=(),
    )
    write_map(tmp_path / "a.map.npz", replace(empty, vote_offset=np.zeros(1, np.int64)))
    assert len(read_map(tmp_path / "a.map.npz").voxel_index) == 0


def test_a_write_that_fails_leaves_the_older_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.map.npz"
    write_map(path, small_map())
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        write_map(path, replace(small_map(), meta={"parameters": {"x": float("nan")}}))
    assert path.read_bytes() == before
    with pytest.raises(OutputError, match="could not be written"):
        write_map(tmp_path / "no" / "such" / "folder.npz", small_map())


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("voxel_index", None, r"has no array voxel_index; expected voxel_index, vote_offset"),
        ("voxel_index", np.zeros((4, 3), np.int64), r"voxel_index is int64 of shape \(4, 3\); expected int32"),
        ("voxel_index", np.zeros((4, 3), ">i4"), r"voxel_index is >i4"),
        ("voxel_index", np.zeros((4, 2), np.int32), r"expected 3 in place of 2"),
        ("voxel_index", np.zeros((4, 3), np.int32), r"voxel_index does not ascend at row 1"),
        ("voxel_index", np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0], [1 << 20, 0, 0]], np.int32), r"range of 21 bits"),
        ("vote_offset", np.array([0, 2, 3, 5], np.int64), r"vote_offset has 4 entries for 4 voxels"),
        ("vote_offset", np.array([0, 2, 2, 5, 6], np.int64), r"vote_offset does not rise from 0 to 6"),
        ("vote_offset", np.array([0, 2, 3, 5, 7], np.int64), r"vote_offset does not rise from 0 to 6"),
        ("vote_fragment", np.array([2, 0, 2, 5, 7, 0], np.int32), r"vote_fragment does not ascend within its voxels"),
        ("vote_fragment", np.array([0, 2, 2, 5, 9, 0], np.int32), r"vote_fragment holds 9, which fragment_id lacks"),
        ("vote_fragment", np.array([-2, 2, 2, 5, 7, 0], np.int32), r"vote_fragment does not ascend"),
        ("vote_count", np.array([1, 2, 3, 0, 5, 6], np.int32), r"vote_count holds a count below 1"),
        ("vote_count", np.ones(7, np.int32), r"vote_count has shape \(7,\); expected 6 in place of 7"),
        ("fragment_id", np.array([2, 7, 5], np.int32), r"fragment_id does not ascend at row 2"),
        ("fragment_id", np.array([0, 2, 5], np.int32), r"holds 7, which fragment_id lacks"),
        ("fragment_instance", np.array([2, 5, 3], np.int32), r"fragment_instance holds 3, which instance_id lacks"),
        ("instance_id", np.array([-2, 5], np.int32), r"instance_id begins with -2"),
        ("voxel_instance", np.array([0, 2, 5, 7], np.int32), r"voxel_instance holds 7, which instance_id lacks"),
        ("voxel_confidence", np.array([0, 0.5, np.nan, 1], np.float32), r"voxel_confidence holds a number outside"),
        ("instance_confidence", np.array([0.5, 1.5], np.float32), r"instance_confidence holds a number outside"),
        ("feature", np.ones((2, 3), np.float32), r"feature holds a row that has neither length 1 nor 0"),
        ("feature_weight", np.array([1.0, np.inf]), r"feature_weight holds a number below 0"),
        ("meta", None, r"is no map file: it has no array meta; a map is what `openvox replay` writes"),
        ("meta", np.frombuffer(b"{", np.uint8), r"meta is no JSON"),
        ("meta", np.frombuffer(b"[" * 100_000, np.uint8), r"meta is no JSON"),
        ("meta", np.frombuffer(b"[]", np.uint8), r"meta has no format version"),
        ("vote_count", np.array([{}] * 6, object), r"array vote_count holds object; expected plain numbers"),
    ],
)
def test_a_wrong_array_is_one_sentence(tmp_path: Path, name: str, value: Any, sentence: str) -> None:
    path = changed(tmp_path, name, value)
    with pytest.raises(InputError, match=sentence) as error:
        read_map(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("format_version", 2, r"has map format 2, this openvox reads up to 1: use a newer openvox"),
        ("voxel_size", 0, r"has voxel_size 0; expected a positive number"),
        ("vote_unit", None, r"has vote_unit None"),
        ("instances", {}, r"does not describe the instances of instance_id"),
        ("instances", {"2": {}, "5": {}}, r"does not describe instance 2 as a map does"),
        ("instances", {"2": {"caption": "\ud800"}, "5": {}}, r"does not describe instance 2 as a map does"),
    ],
)
def test_wrong_meta_is_one_sentence(tmp_path: Path, key: str, value: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        read_map(with_meta(tmp_path, **{key: value}))


def test_what_is_no_npz_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("not a zip")
    for path, sentence in (
        (tmp_path / "text.npz", "is no whole .npz file"),
        (tmp_path / "missing.npz", "cannot be read"),
        (tmp_path, "cannot be read"),
    ):
        with pytest.raises(InputError, match=sentence):
            read_map(path)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.npy", bytes(FREE_BYTES * 2))
    assert path.stat().st_size < 40_000
    with pytest.raises(InputError, match=r"more than the \d+ that its size can mean"):
        read_map(path)


def test_a_header_that_states_more_than_is_there_is_refused(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 40, 1 << 40)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("meta.npy", header.getvalue())
    with pytest.raises(InputError, match=r"states shape \(1099511627776, 1099511627776\) of float64, but 0 bytes"):
        read_map(tmp_path / "a.npz")


def test_two_arrays_of_one_name_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("meta.npy", b"")
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("meta.npy", b"")
    with pytest.raises(InputError, match="some of the same name"):
        read_arrays(tmp_path / "a.npz", lambda name: True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "a.map.npz"
    write_map(path, small_map())
    return path.read_bytes()


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_a_damaged_file_is_the_same_map_or_one_sentence(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    damaged = bytearray(whole)
    for place in data.draw(st.lists(st.integers(0, len(whole) - 1), min_size=1, max_size=3)):
        damaged[place] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "damaged.map.npz"
    path.write_bytes(damaged[: data.draw(st.integers(0, len(whole)))] if data.draw(st.booleans()) else damaged)
    sentence = ""
    try:
        digest = map_digest(read_map(path))
    except InputError as error:
        sentence = str(error)
    assert (digest == map_digest(small_map())) if not sentence else "\n" not in sentence
