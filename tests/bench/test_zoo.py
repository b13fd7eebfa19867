"""The zoo's study: parts that bins are full of come to rest, and another engine finds them so."""

import json

import numpy as np
import pytest
import trimesh

from graycast.bench import study_zoo, zoo
from graycast.bench.balance import unbalanced_m
from graycast.bench.zoo_parts import ZOO
from graycast.drop.body import body_of
from graycast.drop.decomposition import hull_of
from graycast.drop.rapier import SKIN_M
from graycast.errors import GraycastError
from graycast.frames import axis_rotation, rigid
from graycast.parts import Material, Mesh, Part
from graycast.scene import Bin, Layout

BIN = Bin(inner_m=(0.4, 0.3, 0.1), friction=0.3)


def rod(friction: float = 0.3):
    shape = trimesh.creation.box((0.1, 0.02, 0.02))
    part = Part(
        name="rod",
        mesh=Mesh(vertices_m=np.array(shape.vertices), faces=np.array(shape.faces)),
        material=Material(),
        density_kg_m3=7800.0,
        friction=friction,
    )
    return body_of(part, (hull_of(part.mesh.vertices_m),))


def lying(*poses) -> Layout:
    return Layout(T_world_part=np.stack(poses), part_index=np.zeros(len(poses), int))


def at(x_m: float, z_m: float, turn=None):
    return rigid(np.eye(3) if turn is None else turn, np.array([x_m, 0.0, z_m]))


def test_two_rods_on_each_other_stay_where_they_lie():
    layout = lying(at(0, 0.01 + SKIN_M), at(0.03, 0.03 + 3 * SKIN_M))
    assert unbalanced_m(BIN, (rod(),), layout).max() < 20e-6


@pytest.mark.parametrize("beyond_m, falls", [(0.048, False), (0.053, True)])
def test_a_rod_falls_off_another_when_its_weight_is_beyond_the_edge(beyond_m, falls):
    """Oracle: statics; the lower rod ends 50 mm from its middle."""
    layout = lying(at(0, 0.01 + SKIN_M), at(beyond_m, 0.03 + 3 * SKIN_M))
    moved_m = unbalanced_m(BIN, (rod(),), layout)
    assert moved_m[1] > 5e-3 if falls else moved_m[1] < 0.1e-3


@pytest.mark.parametrize("friction, slides", [(0.1, True), (0.7, False)])
def test_a_rod_leans_on_the_wall_where_friction_holds_it(friction, slides):
    """Oracle: a ladder at angle a slides where tan a < (1 - mu^2) / (2 mu): here tan a = 1.19."""
    angle = np.deg2rad(50)
    turn = axis_rotation("y", -angle)
    corners = rod().box_m @ turn.T
    place = at(0.2 - SKIN_M - corners[:, 0].max(), SKIN_M - corners[:, 2].min(), turn)
    box = Bin(inner_m=(0.4, 0.3, 0.1), friction=friction)
    moved_m = unbalanced_m(box, (rod(friction),), lying(place))
    assert moved_m[0] > 5e-3 if slides else moved_m[0] < 0.5e-3


@pytest.mark.slow
def test_a_bolt_makes_scenes_and_lies_in_balance(tmp_path):
    """The part that once came to no rest on the empty floor."""
    figures = study_zoo(families=("hex_bolt",), counts=(1, 10), seeds=2, hull_folder=tmp_path)
    for row in figures["zoo"]:
        assert (row["made"], row["most"], row["balanced"]) == (2, 1, 2), row


@pytest.mark.slow
def test_boxes_that_lie_on_faces_are_in_balance(tmp_path):
    """Judged by one or two points of each contact they rocked by 1 to 41 mm: see balance.py."""
    figures = study_zoo(families=("yellow_salt_cube",), counts=(7,), seeds=4, hull_folder=tmp_path)
    (row,) = figures["zoo"]
    assert (row["made"], row["balanced"]) == (4, 4), row


@pytest.mark.slow
def test_ten_tubes_of_many_hulls_come_to_rest(tmp_path):
    """With the engine's clustering of contacts they never do."""
    (row,) = study_zoo(families=("tube",), counts=(10,), seeds=1, hull_folder=tmp_path)["zoo"]
    assert row["made"] == row["asked"] == 1, row


@pytest.mark.slow
def test_families_that_trembled_for_ever_come_to_rest(tmp_path):
    names = ("socket_screw", "rivet", "tube", "o_ring", "spring", "chain", "shaft", "gear")
    figures = study_zoo(families=names, counts=(1, 10), seeds=2, hull_folder=tmp_path)
    assert len(figures["zoo"]) == 2 * len(names)
    for row in figures["zoo"]:
        assert row["made"] == row["asked"] and row["overlap_mm"] <= 0.5, row
        assert row["balanced"] >= 1, row


NAMES = ("nut", "pin")  # of a study of eight drops that takes a second
STUDY = {"families": NAMES, "counts": (1, 2), "seeds": 2}


def stop_at(words, file):
    """A study that is ended when it begins with this."""

    def stop(share, what):
        if what.endswith(words):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study_zoo(**STUDY, file=file, hull_folder=file.parent, on_work=stop)
    return json.loads(file.read_text())


def untimed(rows):
    return [{name: row[name] for name in row if "cpu" not in name} for row in rows]


@pytest.mark.slow
def test_a_stopped_study_has_its_drops_in_its_file_and_goes_on(tmp_path):
    """The table is that of a study that nobody stopped, and no drop is made anew."""
    file = tmp_path / "zoo.json"
    stopped = stop_at("pin: 1 of them, drop 2 of 2", file)
    assert [(row["family"], row["asked"]) for row in stopped["zoo"]] == [("nut", 2), ("pin", 1)]
    assert (stopped["rows"], stopped["rows_with_19_of_20_made"]) == (1, 1)
    steps, rows = [], []
    went_on = study_zoo(
        **STUDY,
        file=file,
        hull_folder=tmp_path,
        on_work=lambda share, what: steps.append(what),
        on_row=rows.append,
    )
    assert [step for step in steps if "1 of them" in step] == ["pin: 1 of them, drop 2 of 2"]
    made = [(row["family"], row["count"]) for row in rows]
    assert made == [("nut", 1), ("pin", 1), ("nut", 2), ("pin", 2)]
    assert rows[0] == stopped["zoo"][0]
    assert went_on["zoo"] == json.loads(file.read_text())["zoo"] == [rows[i] for i in (0, 2, 1, 3)]
    whole = study_zoo(**STUDY, hull_folder=tmp_path)
    assert untimed(whole["zoo"]) == untimed(went_on["zoo"])
    assert whole["rows_with_19_of_20_made"] == 4
    assert [path.name for path in tmp_path.iterdir() if "part" in path.name] == []


def test_a_row_is_what_its_drops_say():
    drops = [
        {"cpu_s": 1.0, "attempts": 1, "overlap_mm": 0.1, "moved_mm": 0.2},
        {"cpu_s": 9.0},
        {"cpu_s": 2.0, "attempts": 3, "overlap_mm": 0.3, "moved_mm": 1.1},
        {"cpu_s": 4.0, "attempts": 2, "overlap_mm": 0.2, "moved_mm": 0.9},
    ]
    assert zoo._row("nut", 5, drops) == {
        "family": "nut", "count": 5, "made": 3, "asked": 4, "attempts": 2, "most": 3,
        "overlap_mm": 0.3, "cpu_s": 3.0, "cpu_most_s": 9.0, "balanced": 2,
        "moved_median_mm": 0.9, "moved_most_mm": 1.1,
    }  # fmt: skip
    assert zoo._row("nut", 5, drops[1:2]) == {
        "family": "nut", "count": 5, "made": 0, "asked": 1, "cpu_s": 9.0, "cpu_most_s": 9.0
    }  # fmt: skip


@pytest.mark.slow
def test_a_study_of_other_settings_does_not_go_on_in_a_file(tmp_path):
    file = tmp_path / "zoo.json"
    stop_at("drop 2 of 2", file)
    before = file.read_bytes()
    for other, named in (
        ({"seeds": 3}, "seeds 2, and this command has 3"),
        ({"counts": (1, 9)}, "counts 1,2, and this command has 1,9"),
        ({"families": ("nut",)}, "families nut,pin, and this command has nut"),
    ):
        with pytest.raises(GraycastError, match=f"{named}: choose another file"):
            study_zoo(**(STUDY | other), file=file, hull_folder=tmp_path)
    assert file.read_bytes() == before


@pytest.mark.parametrize("text", ["{", "[1]", "{}", '{"benchmark": "drop", "zoo": []}'])
def test_a_file_of_something_else_is_not_written_over(tmp_path, text):
    file = tmp_path / "mine.json"
    file.write_text(text)
    with pytest.raises(GraycastError, match=r"mine\.json: .*choose another file"):
        study_zoo(**STUDY, file=file, hull_folder=tmp_path)
    assert file.read_text() == text


def test_a_file_that_cannot_be_written_is_said_before_the_work(tmp_path):
    with pytest.raises(GraycastError, match="nowhere"):
        study_zoo(**STUDY, file=tmp_path / "nowhere" / "zoo.json", hull_folder=tmp_path)


def test_a_family_that_is_not_in_the_zoo_is_named():
    with pytest.raises(ValueError, match=r"unicorn.*hex_bolt"):
        study_zoo(families=("nut", "unicorn"), on_row=pytest.fail)
    assert len(set(ZOO)) == len(ZOO) >= 20
