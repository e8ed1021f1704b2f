"""OPV2V: CARLA's axes by hand, small drives written by hand, true and noisy poses, broken files named."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cp_env.scenes import open_source
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats import pcd
from cp_env.scenes.opv2v.axes import carla_motion
from cp_env.scenes.opv2v.files import read_note
from cp_env.scenes.opv2v.folders import survey
from cp_env.scenes.opv2v.source import OPV2V

# A drive by hand, in CARLA's axes: the road is 10 m up; the ego (7) drives east, a partner (12) 20 m ahead of it drives
# south, a parked van (3) is met by the partner only; each sensor stands 0.5 m behind and 1.9 m above its vehicle.
BOX = {"center": [0.1, 0.0, 0.75], "extent": [2.45, 1.06, 0.75], "speed": 0.0}
VAN = {
    "location": [115.0, 58.0, 10.1],
    "angle": [0.0, 180.0, 0.0],
    "center": [0.0, 0.0, 1.2],
    "extent": [2.8, 1.0, 1.2],
}
ROOF = [[2.0, 0.0, -0.4], [-1.5, 0.5, -0.3]]  # returns from the car that carries the sensor


def note(
    x: float, y: float, yaw: float, vehicles: dict[int, Any], predicted: list[float] | None = None
) -> dict[str, Any]:
    body = [x, y, 10.0, 0.0, yaw, 0.0]
    back = carla_motion(np.array(body)) @ [-0.5, 0.0, 1.9, 1.0]
    return {
        "camera0": {"cords": [0.0] * 6, "intrinsic": [[1.0, 0.0], [0.0, 1.0]]},
        "ego_speed": 36.0,
        "lidar_pose": [*back.tolist(), 0.0, yaw, 0.0],
        "plan_trajectory": [[1.0, 2.0, 3.0]],
        "predicted_ego_pos": predicted or body,
        "true_ego_pos": body,
        "vehicles": vehicles,
    }


def dumped(said: dict[str, Any]) -> str:
    return str(yaml.dump(said, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper)))


def loaded(text: str) -> dict[str, Any]:
    said: dict[str, Any] = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    return said


def write_note(file: Path, said: dict[str, Any], points: list[list[float]]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.with_suffix(".yaml").write_text(dumped(said))
    pcd.write(file.with_suffix(".pcd"), np.array(points, dtype=np.float32))


def write_drive(root: Path, *, frames: int = 4, rsu: bool = False) -> Path:
    folder = root / "2021_08_16"
    for k in range(frames):
        number = f"{69 + 2 * k:06d}"
        ego, partner = (100.0 + k, 50.0, 0.0), (120.0, 50.0 + k, 90.0)
        seen = {12: {**BOX, "location": [*partner[:2], 10.0], "angle": [0.0, 90.0, 0.0]}}
        write_note(folder / "7" / number, note(*ego, seen), [[10.0, 3.0, -1.9], [19.6, -0.5, -1.0], *ROOF])
        listed = {7: {**BOX, "location": [*ego[:2], 10.0], "angle": [0.0, 0.0, 0.0]}, 3: VAN}
        write_note(folder / "12" / number, note(*partner, listed), [[4.0, 0.0, -1.9], [8.5 - k, 4.0, -1.2], *ROOF])
        if rsu:
            unit = {"lidar_pose": [110.0, 40.0, 16.0, 0.0, 0.0, 0.0], "vehicles": {}}
            for name in ("-1", "-2"):
                write_note(folder / name / number, unit, [[0.0, 5.0, -6.0]])
    return folder


def test_a_drive_by_hand(tmp_path: Path) -> None:
    write_drive(tmp_path)
    source = OPV2V(tmp_path, stride=1)
    assert source.names() == ("2021_08_16",)
    scene = source.load("2021_08_16")
    assert scene.n_frames == 4 and scene.dt == pytest.approx(0.1)
    assert scene.connected.tolist() == [0, 1] and scene.rsu is None
    assert np.allclose(scene.size, [[4.9, 2.12, 1.5], [4.9, 2.12, 1.5], [5.6, 2.0, 2.4]])
    # names sort as text: "12" comes before "7" and is the ego; centres lie 0.1 m ahead of origins
    assert np.allclose(scene.pose[0], [[120, -50.1, -np.pi / 2], [100.1, -50, 0], [115, -58, -np.pi]])
    assert np.allclose(scene.pose[3], [[120, -53.1, -np.pi / 2], [103.1, -50, 0], [115, -58, -np.pi]])
    (ego, partner), *_ = source.sweeps(scene, [0])
    assert np.allclose(ego.origin, [120, -50.1, 1.9]) and np.allclose(partner.origin, [100.1, -50, 1.9])
    # The ego's sensor looks south from 0.4 m north of its middle... of its own car nothing is left
    assert np.allclose(ego.points, [[0, 0.6 - 4, 0], [-4, 0.6 - 8.5, 0.7]], atol=1e-5)
    assert np.allclose(partner.points, [[9.4, -3, 0], [19.0, 0.5, 0.9]], atol=1e-5)
    assert ego.hits is not None and ego.hits.tolist() == [0, 0, 1], "the van"
    assert partner.hits is not None and partner.hits.tolist() == [1, 0, 0], "the ego"


def test_five_frames_a_second_unless_asked_otherwise(tmp_path: Path) -> None:
    write_drive(tmp_path, frames=5)
    name = "2021_08_16"
    assert (OPV2V(tmp_path).load(name).n_frames, OPV2V(tmp_path).load(name).dt) == (3, pytest.approx(0.2))
    every, third = OPV2V(tmp_path, stride=1), OPV2V(tmp_path, stride=3)
    assert every.load(name).dt == pytest.approx(0.1) and third.load(name).dt == pytest.approx(0.3)
    assert (third.load(name).pose[1] == every.load(name).pose[3])[:2].all()
    consecutive = OPV2V(tmp_path, tick=0.1)
    assert consecutive.load(name).dt == pytest.approx(0.2) and consecutive.load(name).n_frames == 5
    assert len({source.digest for source in (OPV2V(tmp_path), every, third, consecutive)}) == 4


def test_who_is_met_by_nobody_stands_where_it_says_and_the_absent_stand_nowhere(tmp_path: Path) -> None:
    folder = write_drive(tmp_path)
    for number in ("000069", "000071"):
        said = loaded((folder / "12" / f"{number}.yaml").read_text())
        (folder / "12" / f"{number}.yaml").write_text(dumped({**said, "vehicles": {}}))
    scene = OPV2V(tmp_path, stride=1).load("2021_08_16")
    assert np.isnan(scene.pose[:2, 2]).all() and np.isfinite(scene.pose[2:, 2]).all()
    assert np.allclose(scene.pose[:, 1, 0], [100.1, 101.1, 102.1, 103.1])
    for number in ("000073", "000075"):
        said = loaded((folder / "12" / f"{number}.yaml").read_text())
        (folder / "12" / f"{number}.yaml").write_text(dumped({**said, "vehicles": {}}))
    scene = OPV2V(tmp_path, stride=1).load("2021_08_16")
    assert np.allclose(scene.size[1], [4.9, 2.12, 1.5]) and np.allclose(scene.pose[:, 1, 0], [100, 101, 102, 103])


def test_the_first_road_side_unit_is_the_last_agent(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, rsu=True)
    assert survey(folder).agents == ("12", "7", "-1")
    source = OPV2V(tmp_path)
    scene = source.load("2021_08_16")
    assert scene.rsu is not None and np.allclose(scene.rsu, [110, -40, 6])
    unit = source.sweeps(scene, [0])[0][-1]
    assert np.allclose(unit.origin, scene.rsu) and np.allclose(unit.points, [[0, -5, 0]])
    without = OPV2V(tmp_path, rsu=False)
    assert without.load("2021_08_16").rsu is None and len(without.sweeps(scene, [0])[0]) == 2
    said = loaded((folder / "-1" / "000073.yaml").read_text())
    said["lidar_pose"][0] += 1
    (folder / "-1" / "000073.yaml").write_text(dumped(said))
    with pytest.raises(BrokenData, match=r"-1.000073\.yaml: the road-side unit's lidar_pose is 1\.00 m from its first"):
        OPV2V(tmp_path).load("2021_08_16")


def test_noise_displaces_what_others_send_and_leaves_the_truth_alone(tmp_path: Path) -> None:
    write_drive(tmp_path, frames=30, rsu=True)
    name = "2021_08_16"
    true, noisy = OPV2V(tmp_path, stride=1), OPV2V(tmp_path, stride=1, noise=(0.4, 2.0), seed=3)
    a, b = true.load(name), noisy.load(name)
    assert (a.pose == b.pose)[np.isfinite(a.pose)].all() and np.allclose(a.rsu, b.rsu)
    shifts, turns = [], []
    for frame, (told, kept) in enumerate(zip(noisy.sweeps(b, range(30)), true.sweeps(a, range(30)), strict=True)):
        assert (told[0].points == kept[0].points).all(), "the ego's own"
        for one, other in zip(told, kept, strict=True):
            assert (one.origin == other.origin).all() and (one.hits == other.hits).all(), frame
        (near, far), (before, after) = told[1].points[:, :2], kept[1].points[:, :2]
        turn = np.angle(complex(*(far - near)) / complex(*(after - before)))
        shift = complex(*near) - complex(*before) * np.exp(1j * turn)
        assert np.linalg.norm(far - near) == pytest.approx(np.linalg.norm(after - before), abs=1e-4), "rigid"
        shifts += [shift.real, shift.imag]
        turns.append(np.rad2deg(turn))
    assert 0.3 < np.std(shifts) < 0.5 and abs(np.mean(shifts)) < 0.15
    assert 1.4 < np.std(turns) < 2.6 and abs(np.mean(turns)) < 1.0
    again, other = (OPV2V(tmp_path, stride=1, noise=(0.4, 2.0), seed=seed) for seed in (3, 4))
    assert (again.sweeps(b, [5])[0][1].points == noisy.sweeps(b, [5])[0][1].points).all()
    assert (other.sweeps(b, [5])[0][1].points != noisy.sweeps(b, [5])[0][1].points).any()
    assert again.digest == noisy.digest and len({true.digest, noisy.digest, other.digest}) == 3


def test_localisation_that_all_get_equally_wrong_displaces_nothing(tmp_path: Path) -> None:
    """Only errors relative to the ego's matter: turn and shift what everybody believes, and nothing changes."""
    folder = write_drive(tmp_path)
    for file in sorted(folder.glob("*/*.yaml")):
        said = loaded(file.read_text())
        x, y, z, roll, yaw, pitch = said["true_ego_pos"]
        c, s = np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))
        said["predicted_ego_pos"] = [float(c * x - s * y + 4), float(s * x + c * y - 9), z, roll, yaw + 30, pitch]
        file.write_text(dumped(said))
    true, predicted = OPV2V(tmp_path), OPV2V(tmp_path, poses="predicted")
    scene = true.load("2021_08_16")
    for told, kept in zip(predicted.sweeps(scene, [0, 1]), true.sweeps(scene, [0, 1]), strict=True):
        for one, other in zip(told, kept, strict=True):
            assert np.allclose(one.points, other.points, atol=1e-4)
    file = folder / "7" / "000069.yaml"
    said = loaded(file.read_text())
    said["predicted_ego_pos"] = said["true_ego_pos"]
    partner = folder / "12" / "000069.yaml"
    told = loaded(partner.read_text())
    x, y, *rest = told["true_ego_pos"]
    partner.write_text(dumped({**told, "predicted_ego_pos": [x + 2.0, y, *rest]}))
    file.write_text(dumped(said))
    sent = OPV2V(tmp_path, poses="predicted").sweeps(scene, [0])[0][1].points
    assert np.allclose(sent - true.sweeps(scene, [0])[0][1].points, [-2, 0, 0], atol=1e-4), "the ego errs by 2 m east"


def test_a_string_opens_it_and_a_pickle_goes_on(tmp_path: Path) -> None:
    write_drive(tmp_path / "test")
    source = open_source(f"opv2v:{tmp_path}?split=test&noise=0.2,0.5&seed=1&vehicles=2&stride=1")
    assert isinstance(source, OPV2V) and source.name == "opv2v/test" and source.options.noise == (0.2, 0.5)
    scene = source.load("2021_08_16")
    again = pickle.loads(pickle.dumps(source))
    assert again.digest == source.digest
    assert (again.sweeps(scene, [2])[0][1].points == source.sweeps(scene, [2])[0][1].points).all()


def test_bad_options_are_refused(tmp_path: Path) -> None:
    write_drive(tmp_path / "train")
    for options, told in (
        ({"poses": "wrong"}, "poses must be one of true, predicted"),
        ({"noise": (0.2,)}, "noise must be two deviations"),
        ({"noise": (0.2, -1.0)}, "noise must be two deviations"),
        ({"stride": 0}, "stride must be at least 1"),
        ({"tick": 0.0}, "tick above 0"),
        ({"scenes": ("2021",)}, "unknown scenes 2021"),
        ({"vehicles": 3}, "has 3 vehicles; the most are 2"),
    ):
        with pytest.raises(ValueError, match=told):
            OPV2V(tmp_path, split="train", **options)  # type: ignore[arg-type]
    with pytest.raises(BrokenData, match="it has the splits train: choose one"):
        OPV2V(tmp_path)
    with pytest.raises(BrokenData, match="is no folder"):
        OPV2V(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="unknown scene 'x'"):
        OPV2V(tmp_path, split="train").load("x")


def damage(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("lidar_pose:", "lidar:", "lacks lidar_pose"),
        ("vehicles: {}", "vehicles: [1, 2]", r"vehicles must be a table by number: got \[1, 2\]"),
        ("vehicles: {}", "vehicles: !!python/object/apply:os.getcwd []", "is no YAML"),
        ("- 16.0\n", "- .nan\n", "lidar_pose must be 6 finite numbers"),
        ("- 16.0\n", "- sixteen\n", "sixteen"),
        ("lidar_pose:\n", "lidar_pose: [1, 2\n", "is no YAML"),
        ("vehicles: {}", "vehicles: {5: car}", "vehicle 5 is 'car'"),
        ("vehicles: {}", "vehicles: {5: {location: [0, 0, 0], angle: [0, 0, 0]}}", "vehicle 5: lacks center"),
        (
            "vehicles: {}",
            "vehicles: {5: {location: [0, 0, 0], angle: [0, 0, 0], center: [0, 0, 0], extent: [1, 0, 1]}}",
            "vehicle 5: extent .* is not positive",
        ),
    ],
)
def test_a_broken_note_is_named(old: str, new: str, told: str, tmp_path: Path) -> None:
    file = write_drive(tmp_path, rsu=True) / "-1" / "000073.yaml"
    file.write_text(damage(file.read_text(), old, new))
    with pytest.raises(BrokenData, match=rf"000073\.yaml: .*{told}"):
        OPV2V(tmp_path).load("2021_08_16")


def test_missing_files_empty_sweeps_and_hostile_notes_are_named(tmp_path: Path) -> None:
    folder = write_drive(tmp_path)
    scene = OPV2V(tmp_path).load("2021_08_16")
    pcd.write(folder / "7" / "000069.pcd", np.zeros((0, 3), dtype=np.float32))
    with pytest.raises(BrokenData, match=r"000069\.pcd: holds no points"):
        OPV2V(tmp_path).sweeps(scene, [0])
    (folder / "7" / "000071.pcd").unlink()
    with pytest.raises(BrokenData, match=r"7.000071\.pcd: is missing"):
        OPV2V(tmp_path)
    file = folder / "12" / "000069.yaml"
    file.write_text("lidar_pose: !!python/object/apply:os.system ['touch stolen']\n")
    with pytest.raises(BrokenData, match="is no YAML"):
        read_note(file)
    with pytest.raises(BrokenData, match="cannot be read"):
        read_note(folder / "none.yaml")
    for agent in ("7", "12"):
        for left in (folder / agent).iterdir():
            left.unlink()
    with pytest.raises(BrokenData, match="hold no frame"):
        OPV2V(tmp_path)


def test_a_broken_file_costs_the_frames_it_touches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Frames are every second file: 69, 73, 77, 81. What is between them costs nothing, whatever it is."""
    for name in ("whole", "cut", "mad", "gone", "between", "unit"):
        write_drive(tmp_path, frames=7, rsu=name == "unit").rename(tmp_path / name)
    cut = tmp_path / "cut" / "7" / "000073.pcd"
    cut.write_bytes(cut.read_bytes()[:-1])
    (tmp_path / "mad" / "12" / "000069.yaml").write_text("vehicles: {}\n")
    (tmp_path / "gone" / "12" / "000081.pcd").unlink()
    (tmp_path / "between" / "7" / "000071.yaml").unlink()
    moved = tmp_path / "unit" / "-1" / "000077.yaml"
    moved.write_text(moved.read_text().replace("- 110.0", "- 111.0", 1))
    with pytest.raises(BrokenData, match=r"is missing \(scene between"):
        OPV2V(tmp_path)
    source = OPV2V(tmp_path, skip_broken=True)
    frames = {name: source.load(name).n_frames for name in source.names()}
    assert frames == {
        "whole": 4, "cut@000069": 1, "cut@000077": 2, "mad": 3, "gone": 3, "between": 4, "unit@000069": 2,
        "unit@000081": 1,
    }  # fmt: skip
    left = {item.scene: f"{item.file.name} {item.reason}" for item in source.left_out}
    assert left.keys() == {
        f"{name}, frame 0000{n}" for name, n in (("cut", 73), ("mad", 69), ("gone", 81), ("unit", 77))
    }
    assert "cut short" in left["cut, frame 000073"] and "lacks lidar_pose" in left["mad, frame 000069"]
    assert "left out scene cut, frame 000073" in "".join(capsys.readouterr())
    whole, piece = source.load("whole"), source.load("cut@000077")
    assert np.array_equal(piece.pose, whole.pose[2:], equal_nan=True) and piece.dt == whole.dt
    assert (source.sweeps(piece, [0])[0][1].points == source.sweeps(whole, [2])[0][1].points).all()
    assert OPV2V(tmp_path, skip_broken=True, scenes=("cut",)).names() == ("cut@000069", "cut@000077")
    assert OPV2V(tmp_path, skip_broken=True, scenes=("cut@000077", "mad")).names() == ("cut@000077", "mad")


def test_a_scenario_without_a_sound_frame_is_left_out(tmp_path: Path) -> None:
    for name in ("whole", "lost"):
        write_drive(tmp_path, frames=2).rename(tmp_path / name)
    for file in (tmp_path / "lost" / "7").glob("*.pcd"):
        file.unlink()
    source = OPV2V(tmp_path, skip_broken=True)
    assert source.names() == ("whole",) and [item.scene for item in source.left_out] == ["lost"]
    assert "no frame whose files are all there" in source.left_out[0].reason


def test_a_scene_follows_one_rate_over_a_gap_in_the_numbers(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, frames=9)
    for agent in ("7", "12"):
        for suffix in (".yaml", ".pcd"):
            (folder / agent / f"000077{suffix}").unlink()
    assert OPV2V(tmp_path).names() == ("2021_08_16@000069", "2021_08_16@000081")
    assert [OPV2V(tmp_path).load(name).n_frames for name in OPV2V(tmp_path).names()] == [2, 2]


def test_what_a_vehicle_is_may_be_chosen(tmp_path: Path) -> None:
    """The van has no class in OPV2V, so it counts; a class makes it what it is."""
    folder = write_drive(tmp_path)
    for kind, classes, counts in (
        (None, ("vehicle",), True),
        ("VAN", ("vehicle",), True),
        ("Pedestrian", ("vehicle",), False),
        ("Trash_Can", ("vehicle",), False),
        ("pedestrian", ("vehicle", "pedestrian"), True),
        ("Van", ("vehicle", "-van"), False),
        ("Hovercraft", ("vehicle", "hovercraft"), True),
    ):
        for file in sorted((folder / "12").glob("*.yaml")):
            said = loaded(file.read_text())
            said["vehicles"][3] = {**VAN} if kind is None else {**VAN, "obj_type": kind}
            file.write_text(dumped(said))
        source = OPV2V(tmp_path, classes=classes)
        scene = source.load("2021_08_16")
        assert len(scene.size) == (3 if counts else 2), kind
        hits = source.sweeps(scene, [0])[0][0].hits
        assert hits is not None and len(hits) == len(scene.size)
    with pytest.raises(BrokenData, match=r"12.000069\.yaml: vehicle 3: .*obj_type 'Hovercraft'.*-hovercraft"):
        OPV2V(tmp_path).load("2021_08_16")


def test_connected_vehicles_count_whatever_they_are_said_to_be(tmp_path: Path) -> None:
    folder = write_drive(tmp_path)
    for file in sorted(folder.glob("*/*.yaml")):
        said = loaded(file.read_text())
        for entry in said["vehicles"].values():
            entry["obj_type"] = "Cyclist"
        file.write_text(dumped(said))
    assert len(OPV2V(tmp_path).load("2021_08_16").size) == 2


def test_aliases_are_read_also_of_what_is_not(tmp_path: Path) -> None:
    folder = write_drive(tmp_path)
    plain = OPV2V(tmp_path, stride=1).load("2021_08_16")
    file = folder / "12" / "000069.yaml"
    said = file.read_text()
    van = dumped({"vehicles": {3: VAN}}).partition("vehicles:\n")[2]
    file.write_text("camera9: &van\n" + van + dumped(loaded(said)).replace(van, "  3: *three\n"))
    file.write_text(file.read_text().replace("  3:\n", "  3: &three\n", 1))
    again = OPV2V(tmp_path, stride=1).load("2021_08_16")
    assert "*three" in file.read_text() and np.allclose(again.pose, plain.pose) and np.allclose(again.size, plain.size)


def test_bounds_of_a_note_are_named(tmp_path: Path) -> None:
    file = write_drive(tmp_path) / "12" / "000069.yaml"
    for text, told in (
        ("vehicles: " + "[" * 100_000, "nested deeper than 32"),
        ("vehicles: {a: 1}\n" + "#" * (4 << 20), "holds .* bytes; at most"),
        ("lidar_pose: [1e999, 0, 0, 0, 0, 0]", "6 finite numbers"),
        ("lidar_pose: [" + "9" * 5000 + ", 0, 0, 0, 0, 0]", "lidar_pose"),
        ("lidar_pose: [0, 0, 0, 0, 0, 0]\nvehicles: {[1]: {}}", "is a key"),
    ):
        file.write_text(text)
        with pytest.raises(BrokenData, match=told):
            read_note(file)


def test_poses_of_v2v4real_are_told_where_they_are_read(tmp_path: Path) -> None:
    folder = write_drive(tmp_path)
    file = folder / "12" / "000069.yaml"
    said = loaded(file.read_text())
    file.write_text(dumped({**said, "lidar_pose": np.eye(4).tolist()}))
    with pytest.raises(BrokenData, match="lidar_pose is a matrix, as in V2V4Real: open the data as v2v4real:PATH"):
        OPV2V(tmp_path).load("2021_08_16")
