"""Parameters refuse nonsense in one sentence, and the last word wins: preset, then file, then --set."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from openvox.core.errors import InputError
from openvox.core.mapper_parameters import OFFICIAL, OPENVOX, PAPER, PRESETS, preset
from openvox.core.parameters import as_dict, describe, from_assignments, from_toml, parameter, updated


@dataclasses.dataclass(frozen=True, kw_only=True)
class Oven:
    heat: float = parameter(180.0, "C", 50.0, 250.0, why="bread likes it")
    minutes: int = parameter(30, "min", 1, 600, why="until brown")
    fan: bool = parameter(True, "", why="even heat")
    speed: int = parameter(3, "", 1, 5, needs="oven.fan", why="of the fan")
    level: str = parameter("middle", "", choices=("low", "middle", "high"), why="where it stands")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kitchen:
    oven: Oven = dataclasses.field(default_factory=Oven)


KITCHEN = Kitchen()


def test_text_is_read_as_the_type_of_the_parameter() -> None:
    changes = {"oven.heat": "200", "oven.minutes": "45", "oven.fan": "on", "oven.level": "high"}
    changed = updated(KITCHEN, changes, source="--set").oven
    assert changed == Oven(heat=200.0, minutes=45, fan=True, level="high")
    assert isinstance(changed.heat, float)
    assert Oven() == KITCHEN.oven, "the set that was given is left alone"


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("oven.heet", "1", "--set: there is no parameter 'oven.heet'; did you mean oven.heat?"),
        ("radio", "1", "--set: there is no parameter 'radio'; openvox info --parameters lists all"),
        ("oven.heat", "251", "--set: oven.heat is 251 C; expected 50 .. 250"),
        ("oven.heat", "nan", "--set: oven.heat is 'nan'; expected a number"),
        ("oven.heat", "inf", "--set: oven.heat is inf C; expected 50 .. 250"),
        ("oven.heat", "hot", "--set: oven.heat is 'hot'; expected a number"),
        ("oven.heat", True, "--set: oven.heat is True; expected a number"),
        ("oven.minutes", "1.5", "--set: oven.minutes is '1.5'; expected a whole number"),
        ("oven.minutes", "1e400", "--set: oven.minutes is '1e400'; expected a whole number"),
        ("oven.minutes", 10**400, f"--set: oven.minutes is {10**400}; expected a whole number"),
        ("oven.fan", "maybe", "--set: oven.fan is 'maybe'; expected true or false"),
        ("oven.level", "top", "--set: oven.level is 'top'; expected one of low, middle, high"),
        ("oven.level", 3, "--set: oven.level is 3; expected text"),
    ],
)
def test_a_wrong_value_is_refused_with_what_was_expected(name: str, value: str | int, sentence: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(sentence)}$"):
        updated(KITCHEN, {name: value}, source="--set")


def test_a_parameter_without_effect_is_refused_and_its_switch_named() -> None:
    with pytest.raises(InputError, match=r"oven\.speed has no effect here, because oven\.fan is off"):
        updated(KITCHEN, {"oven.fan": "false", "oven.speed": "2"}, source="--set")
    assert updated(KITCHEN, {"oven.speed": "2"}, source="--set").oven.speed == 2


def test_file_goes_over_preset_and_set_over_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[map]\nvoxel_size = 0.05\n[association]\nthreshold = 0.3\n")
    changed = updated(
        updated(PAPER, from_toml(path), source=str(path)), {"association.threshold": "0.2"}, source="--set"
    )
    assert changed.map.voxel_size == 0.05
    assert changed.association.threshold == 0.2
    assert as_dict(changed) == as_dict(PAPER) | {"map.voxel_size": 0.05, "association.threshold": 0.2}


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("[map\n", "cannot be read as TOML"),
        ("voxel_size = 1\n", "'voxel_size' stands outside a table"),
        ("[map]\nvoxel_size = [1, 2]\n", r"map.voxel_size is \[1, 2\]; expected a number, a text, true or false"),
    ],
)
def test_a_file_that_is_not_parameters_says_what_it_is(tmp_path: Path, content: str, complaint: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(content)
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}: {complaint}"):
        from_toml(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: no such file"):
        from_toml(tmp_path / "none.toml")


def test_assignments_keep_equals_signs_in_the_value_and_lose_spaces() -> None:
    assert from_assignments(["a.b = x=y", "c.d=1"]) == {"a.b": "x=y", "c.d": "1"}


@pytest.mark.parametrize("text", ["a.b", "=1", "a.b=", " = "])
def test_an_assignment_of_another_form_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"expected group\.key=value"):
        from_assignments([text])


def test_an_assignment_given_twice_is_refused() -> None:
    with pytest.raises(InputError, match=r"a\.b is given twice"):
        from_assignments(["a.b=1", "a.b=2"])


@pytest.mark.parametrize("name", PRESETS)
def test_every_parameter_of_a_preset_is_described_and_within_its_range(name: str) -> None:
    values = as_dict(preset(name))
    rows = describe(preset(name))
    assert [row.name for row in rows] == list(values)
    for row in rows:
        assert row.why, row.name
        assert row.range, row.name
        assert not row.needs or isinstance(values[row.needs], bool), row.name
        if (not row.needs or values[row.needs]) and not (row.without and values[row.without]):
            assert updated(preset(name), {row.name: values[row.name]}, source="test") == preset(name)


def test_what_another_switch_replaces_cannot_be_set_beside_it() -> None:
    sentence = "evolution.veto has no effect here, because evolution.background is on; set evolution.background=false"
    with pytest.raises(InputError, match=sentence):
        updated(OPENVOX, {"evolution.veto": True}, source="--set")
    assert not updated(OFFICIAL, {"masks.one_vote": True}, source="--set").masks.inliers  # rests on what it replaces


def test_an_unknown_preset_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="no preset 'best'; known: openvox, official, paper"):
        preset("best")


def test_a_rule_of_the_openvox_preset_cannot_be_tuned_in_the_paper_preset() -> None:
    with pytest.raises(
        InputError, match=r"lifecycle\.contradiction has no effect here, because lifecycle\.evidence is off"
    ):
        updated(PAPER, {"lifecycle.contradiction": "2"}, source="--set")


def test_what_rests_on_a_switch_goes_off_with_it() -> None:
    chosen = as_dict(updated(OPENVOX, {"association.containment": False}, source="--set"))
    rests = ("evolution.voxel_votes", "lifecycle.evidence", "evolution.abstention", "evolution.cut", "lifecycle.kinds")
    assert {name: chosen[name] for name in rests} == dict.fromkeys(rests, False)
    assert chosen["evolution.background"] is True


def test_to_switch_off_what_is_off_is_no_error() -> None:
    changes = {"association.containment": False, "evolution.cut": False}
    assert as_dict(updated(OPENVOX, changes, source="--set"))["evolution.cut"] is False


def test_openvox_without_its_rules_is_paper() -> None:
    switches = ("masks.one_vote", "association.containment", "evolution.background", "finish.existence")
    numbers = {
        "masks.min_pixels": 0,
        "evolution.near": 0.0,
        "finish.smoothing": 0,
        "finish.rounds": 0,
        "finish.holes": 0.0,
    }
    assert updated(OPENVOX, {**dict.fromkeys(switches, False), **numbers}, source="test") == PAPER
