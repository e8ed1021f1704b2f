"""`cp-play` on toy scenes: what is played, what is kept, what is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.commands import play
from agents.commands.play import Args, conditions_of, learned, play_all, scripted, write
from agents.learning.rollout import Episodes
from cp_env.metrics.shares import share_interval

SCENES = "tests.helpers.toy_scenes:ToySource:n_frames=3,n_connected=3"


@pytest.fixture
def args(tmp_path: Path) -> Args:
    return Args(
        defenders=("none", "ego_only"),
        attacks=("noise", "pgd:steps=1"),
        policies=("prbi-0",),
        scenes=SCENES,
        n_scenes=1,
        frames=2,
        vehicles=3,
        k=1,
        out=tmp_path,
    )


def test_which_attacks_meet_a_defender() -> None:
    assert scripted("prbi", Args())[0] == play.THRESHOLD_AWARE["prbi"] and scripted("none", Args()) == list(play.COMMON)
    assert scripted("prbi", Args(attacks=("pgd",))) == ["pgd"]
    shipped = learned("prbi", Args())
    assert "policy:name=prbi-0" in shipped and not any("robosac" in spec for spec in shipped)
    assert learned("mine:Halves", Args(policies=("a.safetensors",))) == ["policy:name=a.safetensors"]


def test_episodes_are_kept_and_told(
    args: Args, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    conditions = conditions_of(args)
    played = play_all(args, conditions)
    assert "plan: 6 attacks on 2 defenders, 1 episodes of 2 frames" in capsys.readouterr().err
    text = write(played, args)
    assert text.count("Against ") == 2 and "policy:name=prbi-0 does" in text
    assert (args.out / "attacks.md").read_text() == text + "\n"
    monkeypatch.setattr(play, "play", None)  # nothing is played again
    again = play_all(args, conditions)
    assert {run: e.damage.tolist() for run, e in again.items()} == {run: e.damage.tolist() for run, e in played.items()}


def test_the_road_side_unit_shares_its_map(args: Args) -> None:
    assert not conditions_of(args).rsu
    conditions = conditions_of(replace(args, vehicles=1, rsu=True))
    assert conditions.settings(1).n_maps == 2 and conditions.describe()["rsu"]


def test_intervals_of_shares_stay_in_their_range(args: Args) -> None:
    """Student's would be 0.700 [-0.161, 1.561] here, and -2.30 at the low end of the verifications."""
    damage, ones = np.array([0.3, 0.9, 0.9]), np.ones(3)
    made = Episodes(damage, ones, ones, np.array([0.0, 0.0, 4.0]), ones, critical=np.array([-0.1, 0.2, 0.2]))
    table = "\n".join(play.report({("none", spec): made for spec in args.attacks}, "none", replace(args, policies=())))
    row = next(line for line in table.splitlines() if line.startswith("| noise |"))
    loss, critical, excluded, verifications = row.strip("| ").split(" | ")[1:]
    assert loss == format(share_interval(damage), ".3f") and loss.endswith("]") and "-" not in loss
    assert critical == "0.10 [-0.33, 0.53]", "a difference may be negative, and has Student's interval"
    assert excluded == "1.00 [0.29, 1.00]" and verifications.startswith("1.33 [0.00, ")


def test_the_programs_film(args: Args) -> None:
    assert play.film(args, conditions_of(args)).read_bytes()[:3] == b"GIF"


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"cp-play: .*holds 2 scenes"):
        play.main(["--scenes", SCENES, "--n-scenes", "5", "--out", str(tmp_path)])
